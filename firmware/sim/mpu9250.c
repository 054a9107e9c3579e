// InvenSense MPU-9250 and MPU-9255.  Registers: RM-MPU-9250A-00 rev. 1.4, page 9 (map, reset
// values), page 11 (scale of the gyroscope), pages 12-14 (rate, filters, ranges), page 44
// (WHO_AM_I).  Times, temperature: PS-MPU-9250A-01 rev. 1.0, page 8 (gyroscope), page 12
// (start-up; 333.87 counts a Celsius).
#include <math.h>

#include "device.h"

enum { SMPLRT_DIV = 0x19, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, ACCEL_CONFIG_2 };
enum { DATA = 0x3B, DATA_END = 0x49, PWR_MGMT_1 = 0x6B, WHO_AM_I = 0x75 };
#define POWER_UP 100e-3  // at most, until registers may be used; 11 ms as a rule
#define GYR_START 35e-3

static void power_up(struct Device *d) {
  d->reg[PWR_MGMT_1] = 0x01;
  d->reg[WHO_AM_I] = d->kind == &MPU9255 ? 0x73 : 0x71;
  d->reg[0x00] = 0xD1;  // the gyroscope's self-test value is anything; here the id of a BMI160
  d->ready_at[1] = d->powered_at + GYR_START;
}

static bool answers(struct Device *d) {
  return board_now() - d->powered_at >= POWER_UP;
}

static void check_awake(const struct Device *d) {
  if (board_now() < d->busy_until) violated("mpu9250: used within 100 ms of its reset");
}

static void write(struct Device *d, uint8_t reg, uint8_t value) {
  const double now = board_now();
  check_awake(d);
  if (reg == PWR_MGMT_1 && (value & 0x80)) {
    device_power_up(d);
    d->powered_at = now - POWER_UP;  // it answers, but must not be used
    d->busy_until = now + POWER_UP;
  } else if (reg == PWR_MGMT_1) {
    d->ready_at[1] = now + GYR_START;
    d->reg[reg] = value;
  } else if (reg >= SMPLRT_DIV && reg <= ACCEL_CONFIG_2) {
    d->reg[reg] = value;
  } else {
    violated("mpu9250: register 0x%02x written", reg);
  }
}

static void latch(struct Device *d, uint8_t reg) {
  if (reg < DATA || reg >= DATA_END) return;
  if (board_now() < d->ready_at[1]) violated("mpu9250: read before it was ready");
  const int filter = d->reg[CONFIG] & 7;
  const double inside_hz = filter == 0 || filter == 7 ? 8000 : 1000;
  const double rate_hz = inside_hz / (1 + (filter ? d->reg[SMPLRT_DIV] : 0));
  const double rate_scale = DEGREE / 131.072 * (1 << (d->reg[GYRO_CONFIG] >> 3 & 3));
  const double force_scale = GRAVITY / 16384 * (1 << (d->reg[ACCEL_CONFIG] >> 3 & 3));
  int16_t counts[6];
  device_sample(d, rate_hz, rate_scale, force_scale, 32768, counts);
  const int16_t temperature = (int16_t)rint((TEMPERATURE - 21) * 333.87);
  put_big(d->reg + DATA, counts + 3);
  d->reg[DATA + 6] = temperature >> 8;
  d->reg[DATA + 7] = temperature & 255;
  put_big(d->reg + DATA + 8, counts);
}

static uint8_t read(struct Device *d, uint8_t reg) {
  check_awake(d);
  return d->reg[reg];
}

const struct Kind MPU9250 = {"mpu9250", power_up, answers, write, read, latch, 0};
const struct Kind MPU9255 = {"mpu9255", power_up, answers, write, read, latch, 0};
