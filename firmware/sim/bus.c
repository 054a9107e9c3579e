// Transactions on the bus: who is reached through the TCA9548A, who answers, what passes.
// TCA9548A, Texas Instruments SCPS207, section 8.6: one control byte, bit n connects channel n,
// after STOP; several may be connected; none after power-up or RESET.
#include "device.h"

#define MUX_ADDRESS 0x70

static uint8_t connected, next_connected;  // channels, as bits
static bool mux_addressed;
static struct Device *addressed[2 * MAX_IMUS];
static int addressed_count;

bool bus_reaches(int channel) {
  return channel == NO_CHANNEL || (connected >> channel & 1);
}

void bus_reset_mux(void) {
  connected = next_connected = 0;
}

void bus_start(void) {
  totals.transactions++;
  mux_addressed = false;
  addressed_count = 0;
}

static bool answers(struct Device *device) {
  if (device->dead || !bus_reaches(device->channel)) return false;
  if (device->kind->answers && !device->kind->answers(device)) return false;
  return !(device->refuse_every > 0 && ++device->asked % device->refuse_every == 0);
}

bool bus_address(uint8_t byte) {
  mux_addressed = byte >> 1 == MUX_ADDRESS;
  addressed_count = 0;
  for (int k = 0; k < device_count; k++) {
    if (devices[k].address == byte >> 1 && answers(&devices[k])) {
      addressed[addressed_count++] = &devices[k];
    }
  }
  if (addressed_count + mux_addressed > 1) contended("several answer to 0x%02x", byte >> 1);
  for (int k = 0; k < addressed_count; k++) {
    struct Device *device = addressed[k];
    device->pointing = !(byte & 1);
    if ((byte & 1) && device->kind->latch) device->kind->latch(device, device->pointer);
  }
  const bool heard = addressed_count + mux_addressed > 0;
  totals.refused += !heard;
  return heard;
}

bool bus_write(uint8_t byte) {
  if (mux_addressed) next_connected = byte;
  for (int k = 0; k < addressed_count; k++) {
    struct Device *device = addressed[k];
    if (device->pointing) {
      device->pointing = false;
      device->pointer = byte;
    } else {
      device->kind->write(device, device->pointer++, byte);
      device->written_at = board_now();
    }
  }
  return mux_addressed || addressed_count > 0;
}

uint8_t bus_read(void) {
  uint8_t byte = mux_addressed ? connected : 0xFF;
  for (int k = 0; k < addressed_count; k++) {
    byte &= addressed[k]->kind->read(addressed[k], addressed[k]->pointer++);
  }
  return byte;
}

void bus_stop(void) {
  connected = next_connected;
  mux_addressed = false;
  addressed_count = 0;
}

double bus_stretch(void) {
  double longest = 0;
  for (int k = 0; k < addressed_count; k++) {
    if (addressed[k]->kind->stretch > longest) longest = addressed[k]->kind->stretch;
  }
  return longest;
}
