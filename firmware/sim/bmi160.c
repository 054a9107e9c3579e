// Bosch BMI160, BST-BMI160-DS000-07 rev. 0.8: section 2.11 (registers; temperature page 54), table
// 2 (accelerometer) and table 3 (gyroscope) for scales and start-up times, the I2C timing table
// for the idle time after writes.  Power-up and reset times are those of common drivers.
#include <math.h>

#include "device.h"

enum { CHIP_ID = 0x00, ERR = 0x02, PMU_STATUS = 0x03, DATA = 0x0C, DATA_END = 0x18 };
enum { TEMPERATURE_0 = 0x20, ACC_CONF = 0x40, ACC_RANGE, GYR_CONF, GYR_RANGE, CMD = 0x7E };
#define POWER_UP 10e-3
#define SOFT_RESET 15e-3
#define ACC_START 3.8e-3
#define GYR_START 80e-3
#define IDLE_SUSPENDED 450e-6  // between writes
#define IDLE_NORMAL 2e-6

static void power_up(struct Device *d) {
  d->reg[CHIP_ID] = 0xD1;
  d->reg[ACC_CONF] = d->reg[GYR_CONF] = 0x28;
  d->reg[ACC_RANGE] = 0x03;
  const int raw = (int)((TEMPERATURE - 23) * 512);
  d->reg[TEMPERATURE_0] = raw & 255;
  d->reg[TEMPERATURE_0 + 1] = raw >> 8;
}

static bool answers(struct Device *d) {
  return board_now() - d->powered_at >= POWER_UP;
}

static bool is_on(const struct Device *d, int sensor) {
  return board_now() >= d->ready_at[sensor];
}

static void command(struct Device *d, uint8_t value) {
  const double now = board_now();
  if (now < d->busy_until) violated("bmi160: command 0x%02x during another", value);
  switch (value) {
    case 0xB6:
      device_power_up(d);
      d->powered_at = now - POWER_UP;  // it answers, but must not be asked
      d->busy_until = now + SOFT_RESET;
      break;
    case 0x11:
      d->ready_at[0] = d->busy_until = now + ACC_START;
      break;
    case 0x15:
      d->ready_at[1] = d->busy_until = now + GYR_START;
      break;
    default:
      violated("bmi160: unknown command 0x%02x", value);
  }
}

static void write(struct Device *d, uint8_t reg, uint8_t value) {
  const bool suspended = isinf(d->ready_at[0]) && isinf(d->ready_at[1]);
  const double idle = suspended ? IDLE_SUSPENDED : IDLE_NORMAL;
  if (d->written_at >= 0 && board_now() - d->written_at < idle) {
    violated("bmi160: written %.0f us after a write", 1e6 * idle);
  }
  if (reg == CMD) {
    command(d, value);
  } else if (reg >= ACC_CONF && reg <= GYR_RANGE) {
    if (board_now() < d->busy_until) violated("bmi160: set during a command");
    d->reg[reg] = value;
  } else {
    violated("bmi160: register 0x%02x written", reg);
  }
}

static double scale_of_rate(const struct Device *d) {
  return DEGREE / 16.4 / (1 << d->reg[GYR_RANGE]);
}

static double scale_of_force(const struct Device *d) {
  switch (d->reg[ACC_RANGE]) {
    case 0x05: return GRAVITY / 8192;
    case 0x08: return GRAVITY / 4096;
    case 0x0C: return GRAVITY / 2048;
    default: return GRAVITY / 16384;
  }
}

static void latch(struct Device *d, uint8_t reg) {
  if (reg < DATA || reg >= DATA_END) return;
  if (!is_on(d, 0) || !is_on(d, 1)) {
    // After a loss of power nobody could know; while starting one must.
    if (isfinite(d->ready_at[0])) violated("bmi160: read before it was ready");
    return;
  }
  const double rate_hz = 100 * pow(2, (d->reg[GYR_CONF] & 15) - 8);
  int16_t counts[6];
  device_sample(d, rate_hz, scale_of_rate(d), scale_of_force(d), 32768, counts);
  put_little(d->reg + DATA, counts);
  put_little(d->reg + DATA + 6, counts + 3);
}

static uint8_t read(struct Device *d, uint8_t reg) {
  if (board_now() < d->busy_until && isinf(d->ready_at[0])) {
    violated("bmi160: read within 15 ms of its reset");
  }
  if (reg == PMU_STATUS) return is_on(d, 0) << 4 | is_on(d, 1) << 2;
  return d->reg[reg];
}

const struct Kind BMI160 = {"bmi160", power_up, answers, write, read, latch, 0};
