#include "link.h"

#include "bus.h"
#include "clock.h"
#include "config.h"
#include "imu.h"
#include "packet.h"
#include "uart.h"

const uint8_t FIRMWARE_MAJOR = 1, FIRMWARE_MINOR = 0;
const uint32_t STATUS_US = 1000000;
const uint32_t GREET_BY_US = 500000;  // even where the bus is stuck

static uint16_t seq, overruns;
static uint16_t longest_us;  // from the begin of a scan to its last byte on the line
static bool greeted;       // the first HELLO has gone
static bool hello_is_due;  // another must go
static uint32_t status_at;

void link_begin() {
  uart_begin();
  status_at = STATUS_US;
}

static bool send_hello(uint8_t reason) {
  uint8_t packet[MAX_PACKET];
  PacketWriter to = {packet};
  to.u8(HELLO);
  to.u8(PROTOCOL);
  to.u8(reason);
  to.u8(FIRMWARE_MAJOR);
  to.u8(FIRMWARE_MINOR);
  to.u16(SCAN_RATE_HZ);
  to.u32(clock_us());
  uint8_t *const count = to.at;
  to.u8(0);
  for (uint8_t k = 0; k < imu_count; k++) {
    const Imu &imu = imus[k];
    if (imu.model == UNKNOWN_MODEL) continue;
    ModelInfo info;
    model_info(imu.model, &info);
    ++*count;
    to.u8(k);
    to.u8(imu.model);
    to.u8(imu.address);
    to.u8(imu.channel);
    to.u16(info.angular_rate_range);
    to.u16(info.specific_force_range);
    to.f32(info.angular_rate_scale);
    to.f32(info.specific_force_scale);
  }
  return uart_send(packet, to.at - packet);
}

static bool send_status() {
  uint8_t packet[11 + 4 * MAX_IMUS];
  PacketWriter to = {packet};
  to.u8(STATUS);
  to.u32(clock_us());
  to.u16(overruns);
  to.u16(bus_recoveries());
  uint8_t mask = 0;
  uint8_t *const mask_at = to.at;
  to.u16(0);
  for (uint8_t k = 0; k < imu_count; k++) {
    if (imus[k].model == UNKNOWN_MODEL) continue;
    mask |= 1 << k;
    to.u16(imus[k].failures);
    to.u16(imus[k].temperature);
  }
  *mask_at = mask;
  return uart_send(packet, to.at - packet);
}

static void answer_sync(const uint8_t *token, uint32_t arrived_us) {
  uint8_t packet[9];
  PacketWriter to = {packet};
  to.u8(SYNC);
  for (uint8_t k = 0; k < 4; k++) to.u8(token[k]);
  to.u32(arrived_us);
  uart_send_first(packet, sizeof packet);
}

bool link_has_greeted() {
  return greeted;
}

void link_answer() {
  Request request;
  while (uart_receive(&request)) {
    const uint8_t length = packet_unframe(request.bytes, request.length);
    const uint8_t *packet = request.bytes + 1;  // behind the first code
    if (length == 1 && packet[0] == HELLO_REQUEST) hello_is_due = true;
    if (length == 5 && packet[0] == SYNC_REQUEST) answer_sync(packet + 1, request.arrived_us);
  }
}

// The host takes the earliest arrivals for the truth.  A scan that lacks IMUs is read and sent
// sooner than others; it waits, so that its last byte has the same delay.
static bool send_scan(const uint8_t *packet, uint8_t length, uint32_t start) {
  if (!uart_frame(packet, length)) return false;
  const uint16_t line_us = (length + AROUND) * BYTE_US;
  const uint16_t lasts_us = clock_us() - start + line_us;
  if (lasts_us > longest_us && bus_is_usable()) longest_us = lasts_us;
  uart_queue(start + longest_us - line_us);
  return true;
}

void link_scan() {
  uint8_t packet[8 + 14 * MAX_IMUS];
  const uint32_t start = clock_us();
  PacketWriter to = {packet};
  to.u8(SCAN);
  to.u16(seq++);
  to.u32(start);
  uint8_t mask = 0;
  uint8_t *const mask_at = to.at;
  to.u8(0);
  for (uint8_t k = 0; k < imu_count; k++) {
    Imu &imu = imus[k];
    const uint16_t instant = clock_us() - start;
    if (!imu_read(imu)) continue;
    mask |= 1 << k;
    to.u16(instant);
    for (uint8_t i = 0; i < COUNTS; i++) to.u16(imu.counts[i]);
  }
  *mask_at = mask;
  if (!send_scan(packet, to.at - packet, start)) overruns++;
}

void link_skip_scan() {
  seq++;
  overruns++;
}

bool link_tend() {
  if (!greeted) {
    if (!imus_known() && !clock_reached(GREET_BY_US)) return false;
    imus_changed();
    return greeted = send_hello(JUST_STARTED);
  }
  hello_is_due |= imus_changed();
  if (hello_is_due) {
    hello_is_due = !send_hello(ASKED);
    return true;
  }
  if (!clock_reached(status_at)) return false;
  if (send_status()) status_at += STATUS_US;
  return true;
}
