// Bosch BNO055, BST-BNO055-DS000-14 rev. 1.4: page 21 (modes, switching times), pages 27-28
// (settings of the sensors), page 33 (16 counts a deg/s), page 53 (data registers, CHIP_ID), page
// 91 (clock stretching, addresses).
#include <math.h>

#include "device.h"

enum { CHIP_ID = 0x00, PAGE_ID = 0x07, ACC = 0x08, MAG = 0x0E, GYR = 0x14, GYR_END = 0x1A };
enum { TEMP = 0x34, UNIT_SEL = 0x3B, OPR_MODE = 0x3D, PAGE_1 = 0x80 };
enum { ACC_CONFIG = PAGE_1 + 0x08, GYR_CONFIG_0 = PAGE_1 + 0x0A };
enum { CONFIG_MODE = 0, AMG_MODE = 7 };
#define POWER_UP 650e-3
#define LEAVE_CONFIG 7e-3
#define ENTER_CONFIG 19e-3
#define DATA_RATE_HZ 100

static void power_up(struct Device *d) {
  d->reg[CHIP_ID] = 0xA0;
  d->reg[UNIT_SEL] = 0x80;
  d->reg[TEMP] = (uint8_t)TEMPERATURE;
  d->reg[ACC_CONFIG] = 0x0D;
  d->reg[GYR_CONFIG_0] = 0x38;
}

static bool answers(struct Device *d) {
  return board_now() - d->powered_at >= POWER_UP;
}

static void check_settled(const struct Device *d) {
  if (board_now() < d->busy_until) violated("bno055: used while it changes its mode");
}

static void set(struct Device *d, uint8_t at, uint8_t value) {
  if ((d->reg[OPR_MODE] & 15) != CONFIG_MODE) violated("bno055: set outside CONFIG mode");
  d->reg[at] = value;
}

static void write(struct Device *d, uint8_t reg, uint8_t value) {
  check_settled(d);
  if (reg == PAGE_ID) {
    d->page = value & 1;
  } else if (d->page == 1) {
    set(d, PAGE_1 + reg, value);
  } else if (reg == OPR_MODE) {
    const bool entering = (value & 15) == CONFIG_MODE;
    d->reg[OPR_MODE] = value;
    d->busy_until = board_now() + (entering ? ENTER_CONFIG : LEAVE_CONFIG);
  } else if (reg == UNIT_SEL) {
    set(d, UNIT_SEL, value);
  } else {
    violated("bno055: register 0x%02x written", reg);
  }
}

static void latch(struct Device *d, uint8_t reg) {
  if (d->page != 0 || reg < ACC || reg >= GYR_END) return;
  if ((d->reg[OPR_MODE] & 15) != AMG_MODE) return;  // the registers stay as they are
  int16_t counts[6];
  const double force_scale = d->reg[UNIT_SEL] & 1 ? GRAVITY / 1000 : 0.01;
  const double rate_scale = d->reg[UNIT_SEL] & 2 ? 1.0 / 900 : DEGREE / 16;
  device_sample(d, DATA_RATE_HZ, rate_scale, force_scale, 32768, counts);
  put_little(d->reg + ACC, counts + 3);
  put_little(d->reg + GYR, counts);
}

static uint8_t read(struct Device *d, uint8_t reg) {
  check_settled(d);
  if (reg == PAGE_ID) return d->page;
  return d->reg[(d->page ? PAGE_1 : 0) + (reg & 0x7F)];
}

// How long it stretches the clock the data sheet does not say; 50 us before each byte is a guess.
const struct Kind BNO055 = {"bno055", power_up, answers, write, read, latch, 50e-6};
