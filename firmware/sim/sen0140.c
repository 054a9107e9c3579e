// The two chips of DFRobot's SEN0140.
// Analog Devices ADXL345, rev. D: page 13 (power), pages 23-27 (registers), table 1 (256 counts a
// g, turn-on time 1.1 ms + 1 / rate).
// InvenSense ITG-3200, PS-ITG-3200A-00-01.4: page 7 (scale, start-up 50 ms, temperature), page 18
// (addresses, 400 kHz), pages 22-27 (registers; FS_SEL must be 3).
#include <math.h>

#include "device.h"

enum { DEVID = 0x00, BW_RATE = 0x2C, POWER_CTL = 0x2D, DATA_FORMAT = 0x31, ADXL_DATA = 0x32 };
enum { MEASURE = 0x08, FULL_RES = 0x08 };

static void adxl_power_up(struct Device *d) {
  d->reg[DEVID] = 0xE5;
  d->reg[BW_RATE] = 0x0A;
}

static double adxl_rate_hz(const struct Device *d) {
  return 3200 * pow(2, (d->reg[BW_RATE] & 15) - 15);
}

static void adxl_write(struct Device *d, uint8_t reg, uint8_t value) {
  const bool measures = d->reg[POWER_CTL] & MEASURE;
  if (reg == POWER_CTL) {
    d->ready_at[0] = value & MEASURE ? board_now() + 1.1e-3 + 1 / adxl_rate_hz(d) : INFINITY;
  } else if (reg == BW_RATE || reg == DATA_FORMAT) {
    if (measures) violated("adxl345: set while it measures");
  } else {
    violated("adxl345: register 0x%02x written", reg);
  }
  d->reg[reg] = value;
}

static void adxl_latch(struct Device *d, uint8_t reg) {
  if (reg < ADXL_DATA || reg >= ADXL_DATA + 6 || isinf(d->ready_at[0])) return;
  if (board_now() < d->ready_at[0]) violated("adxl345: read before it was ready");
  const int range = d->reg[DATA_FORMAT] & 3;
  const bool full = d->reg[DATA_FORMAT] & FULL_RES;
  int16_t counts[6];
  device_sample(d, adxl_rate_hz(d), 0, GRAVITY / 256 * (full ? 1 : 1 << range),
                full ? 512 << range : 512, counts);
  put_little(d->reg + ADXL_DATA, counts + 3);
}

enum { WHO_AM_I = 0x00, SMPLRT_DIV = 0x15, DLPF_FS = 0x16, TEMP_OUT = 0x1B, ITG_DATA = 0x1D };
enum { PWR_MGM = 0x3E };
#define ITG_POWER_UP 20e-3
#define ITG_START 50e-3

static void itg_power_up(struct Device *d) {
  d->reg[WHO_AM_I] = 0x68;
  d->ready_at[1] = d->powered_at + ITG_START;
  const int16_t temperature = (int16_t)rint((TEMPERATURE - 35) * 280 - 13200);
  d->reg[TEMP_OUT] = (uint16_t)temperature >> 8;
  d->reg[TEMP_OUT + 1] = temperature & 255;
}

static bool itg_answers(struct Device *d) {
  return board_now() - d->powered_at >= ITG_POWER_UP;
}

static void itg_write(struct Device *d, uint8_t reg, uint8_t value) {
  const double now = board_now();
  if (now < d->busy_until) violated("itg3200: written within 20 ms of its reset");
  if (reg == PWR_MGM && (value & 0x80)) {
    device_power_up(d);
    d->powered_at = now - ITG_POWER_UP;
    d->busy_until = now + ITG_POWER_UP;
  } else if (reg == PWR_MGM) {
    d->ready_at[1] = now + ITG_START;
    d->reg[reg] = value;
  } else if (reg == SMPLRT_DIV || reg == DLPF_FS) {
    d->reg[reg] = value;
  } else {
    violated("itg3200: register 0x%02x written", reg);
  }
}

static void itg_latch(struct Device *d, uint8_t reg) {
  if (reg < ITG_DATA || reg >= ITG_DATA + 6) return;
  if (board_now() < d->ready_at[1]) violated("itg3200: read before it was ready");
  const bool filtered = (d->reg[DLPF_FS] & 7) != 0;
  const double rate_hz = (filtered ? 1000.0 : 8000.0) / (1 + d->reg[SMPLRT_DIV]);
  int16_t counts[6] = {0};
  // The scale is promised for FS_SEL 3 only.
  if ((d->reg[DLPF_FS] >> 3 & 3) == 3) {
    device_sample(d, rate_hz, DEGREE / 14.375, 0, 32768, counts);
  }
  put_big(d->reg + ITG_DATA, counts);
}

static uint8_t read(struct Device *d, uint8_t reg) {
  return d->reg[reg];
}

const struct Kind ADXL345 = {"adxl345", adxl_power_up, NULL, adxl_write, read, adxl_latch, 0};
const struct Kind ITG3200 = {"itg3200", itg_power_up, itg_answers, itg_write, read, itg_latch, 0};
