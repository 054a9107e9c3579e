#include "imu.h"

#include <avr/pgmspace.h>
#include <string.h>

#include "bus.h"
#include "clock.h"
#include "config.h"

const uint32_t POWER_UP_US = 20000;  // until the first IMU can answer
const uint32_t RETRY_US = 10000;     // of a step that failed
const uint8_t GIVE_UP = 3;           // failures in a row
// Noise repeats all six counts once in a while, but hardly twice in a row.
const uint8_t REPEATS = 1;
const uint8_t FROZEN = 50;
const uint8_t CANDIDATES[] = {0x68, 0x69, 0x29, 0x28};

struct Place {
  uint8_t channel, address;
};
const Place PLACES[] = {IMU_PLACES};
const uint8_t imu_count = sizeof PLACES / sizeof PLACES[0];
static_assert(imu_count <= MAX_IMUS, "IMU_PLACES must be at most eight");
// A byte has ten bits on the line; a scan 8 bytes, 14 for each IMU, and 6 of its frame.
static_assert(BAUD / 10 / (8 + 14 * imu_count + 6) >= SCAN_RATE_HZ,
              "BAUD must be higher, or SCAN_RATE_HZ lower");

Imu imus[MAX_IMUS];
static bool changed;

void imus_begin() {
  for (uint8_t k = 0; k < imu_count; k++) {
    imus[k].channel = PLACES[k].channel;
    imus[k].temperature = UNKNOWN_TEMPERATURE;
  }
}

bool imus_known() {
  for (uint8_t k = 0; k < imu_count; k++) {
    if (!imus[k].looked) return false;
  }
  return true;
}

bool imus_ready() {
  for (uint8_t k = 0; k < imu_count; k++) {
    if (imus[k].state != READY) return false;
  }
  return true;
}

bool imus_changed() {
  const bool answer = changed;
  changed = false;
  return answer;
}

static void lose(Imu &imu) {
  imu.state = ABSENT;
  imu.candidate = 0;
  imu.temperature = UNKNOWN_TEMPERATURE;
}

static bool fail(Imu &imu) {
  imu.failures++;
  // Where the bus is stuck none can answer; the one that was being read may be the cause.
  if (++imu.failed_in_row >= GIVE_UP) lose(imu);
  return false;
}

// All zero is what registers hold before the first reading.
static bool is_blank(const int16_t *counts) {
  int16_t any = 0;
  for (uint8_t k = 0; k < COUNTS; k++) any |= counts[k];
  return any == 0;
}

bool imu_read(Imu &imu) {
  if (imu.state != READY) return false;
  if (!bus_is_usable()) {
    imu.failures++;
    return false;
  }
  int16_t counts[COUNTS];
  if (!bus_select(imu.channel) || !model_read(imu.model, imu.address, counts)) return fail(imu);
  if (is_blank(counts)) return fail(imu);
  imu.failed_in_row = 0;
  if (memcmp(counts, imu.counts, sizeof counts) != 0) {
    memcpy(imu.counts, counts, sizeof counts);
    imu.repeats = 0;
    return true;
  }
  if (++imu.repeats <= REPEATS) return true;
  imu.failures++;
  if (imu.repeats == FROZEN) lose(imu);
  return false;
}

static void found(Imu &imu, Model model, uint8_t address) {
  changed |= imu.model != model || imu.address != address;
  imu.model = model;
  imu.address = address;
  imu.state = STARTING;
  imu.step = 0;
  imu.failed_in_row = 0;
  imu.waiting = false;
  imu.due = clock_us();
}

static void look(Imu &imu, uint8_t only) {
  const uint8_t address = only != ANY ? only : CANDIDATES[imu.candidate];
  const Model model = bus_select(imu.channel) ? model_at(address) : UNKNOWN_MODEL;
  const bool last = only != ANY || ++imu.candidate == sizeof CANDIDATES;
  if (last) imu.candidate = 0;
  if (model != UNKNOWN_MODEL) found(imu, model, address);
  // A bus that is stuck says nothing about what is on it.
  if (bus_is_usable() && (last || model != UNKNOWN_MODEL)) imu.looked = true;
}

static Step step_of(const Imu &imu, uint8_t k, uint8_t *count) {
  ModelInfo info;
  model_info(imu.model, &info);
  *count = info.step_count;
  Step step;
  memcpy_P(&step, info.steps + k, sizeof step);
  return step;
}

// Do one half of a step: write and wait, or look whether it was taken.
static bool do_half(const Imu &imu, const Step &step) {
  if (!bus_select(imu.channel)) return false;
  if (!imu.waiting) return step_write(step, imu.address);
  if (!(step.kind & VERIFY)) return true;
  uint8_t value;
  return step_read(step, imu.address, &value) && value == step.value;
}

static void go_on(Imu &imu) {
  uint8_t count;
  const Step step = step_of(imu, imu.step, &count);
  if (!do_half(imu, step)) {
    if (++imu.failed_in_row >= GIVE_UP) return lose(imu);
    imu.waiting = false;  // once more, from its beginning
    imu.due = clock_us() + RETRY_US;
    return;
  }
  imu.waiting = !imu.waiting;
  if (imu.waiting) {
    imu.due = clock_us() + step.wait_ms * 1000UL;
    return;
  }
  imu.failed_in_row = 0;
  if (++imu.step < count) return;
  imu.state = READY;
  imu.step = 0;
  // What it repeated before its start is still nothing new.
  if (imu.repeats > REPEATS) imu.repeats = REPEATS;
}

// Look whether an IMU is still set as it was: it may have lost its power for a moment.
static void watch(Imu &imu) {
  uint8_t count, value;
  Step step;
  do {
    step = step_of(imu, imu.step, &count);
    imu.step = imu.step + 1 < count ? imu.step + 1 : 0;
  } while (!(step.kind & WATCH));
  // One that does not answer is noticed by the scans.
  if (!bus_select(imu.channel) || !step_read(step, imu.address, &value)) return;
  if (value == step.value) return;
  imu.failures++;
  lose(imu);
}

static void look_after(Imu &imu, uint8_t k, bool at_temperature) {
  if (imu.state == ABSENT) {
    look(imu, PLACES[k].address);
  } else if (imu.state == READY) {
    watch(imu);
    if (!at_temperature || imu.state != READY || !bus_select(imu.channel)) return;
    model_temperature(imu.model, imu.address, &imu.temperature);
  }
}

void imus_tend(bool rested) {
  static uint8_t next, round;
  static bool powered;
  powered = powered || clock_reached(POWER_UP_US);
  if (!powered || !bus_is_usable()) return;
  for (uint8_t k = 0; k < imu_count; k++) {
    if (imus[k].state == STARTING && clock_reached(imus[k].due)) return go_on(imus[k]);
  }
  if (!rested) return;
  look_after(imus[next], next, round % 8 == 0);
  if (++next < imu_count) return;
  next = 0;
  round++;
}
