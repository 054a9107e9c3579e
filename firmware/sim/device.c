#include "device.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct Device devices[2 * MAX_IMUS];
int device_count;

static void add_chip(int imu, const struct Kind *kind, int channel, int address) {
  struct Device *device = &devices[device_count++];
  device->kind = kind;
  device->imu = imu;
  device->channel = channel;
  device->address = address;
  device_power_up(device);
}

void device_add(int imu, const char *name, int channel, int address) {
  static const struct Kind *const KINDS[] = {&BMI160, &MPU9250, &MPU9255, &BNO055};
  if (device_count + 2 > 2 * MAX_IMUS) {
    fprintf(stderr, "There is room for %d chips.\n", 2 * MAX_IMUS);
    exit(2);
  }
  if (strcmp(name, "sen0140") == 0) {
    add_chip(imu, &ITG3200, channel, address);
    add_chip(imu, &ADXL345, channel, 0x53);
    return;
  }
  for (unsigned k = 0; k < sizeof KINDS / sizeof KINDS[0]; k++) {
    if (strcmp(name, KINDS[k]->name) == 0) return add_chip(imu, KINDS[k], channel, address);
  }
  fprintf(stderr, "No device is called `%s`.\n", name);
  exit(2);
}

void device_power_up(struct Device *device) {
  memset(device->reg, 0, sizeof device->reg);
  device->powered_at = avr ? board_now() : 0;
  device->written_at = -1;
  device->busy_until = 0;
  device->ready_at[0] = device->ready_at[1] = INFINITY;
  device->page = 0;
  device->frozen = device->frozen_for_good;
  device->kind->power_up(device);
}

void device_fault(int imu, const char *what, int number) {
  for (int k = 0; k < device_count; k++) {
    struct Device *device = &devices[k];
    if (device->imu != imu) continue;
    if (strcmp(what, "dead") == 0) {
      device->dead = true;
    } else if (strcmp(what, "alive") == 0) {  // somebody pushed the plug back in
      device->dead = false;
      device_power_up(device);
    } else if (strcmp(what, "brownout") == 0) {
      device_power_up(device);
      device->powered_at = -INFINITY;  // it answers at once: the hardest to notice
    } else if (strcmp(what, "freeze") == 0) {
      device->frozen = true;
      device->frozen_for_good = number;
      device->frozen_at = board_now();
    } else if (strcmp(what, "thaw") == 0) {
      device->frozen = device->frozen_for_good;
    } else if (strcmp(what, "refuse") == 0) {
      device->refuse_every = number;
    } else {
      fprintf(stderr, "No fault is called `%s`.\n", what);
      exit(2);
    }
  }
}

void device_sample(struct Device *device, double rate_hz, double angular_rate_scale,
                   double specific_force_scale, int limit, int16_t counts[6]) {
  const double now = device->frozen ? device->frozen_at : board_now();
  const long n = (long)floor(now * rate_hz);
  if (motion_counts(device->imu, n, counts)) return;
  double values[6];
  motion_at(device->imu, n, n / rate_hz, values);
  for (int k = 0; k < 6; k++) {
    const double scale = k < 3 ? angular_rate_scale : specific_force_scale;
    const double count = scale > 0 ? rint(values[k] / scale) : 0;
    counts[k] = (int16_t)fmax(-limit, fmin(limit - 1, count));
  }
}

void put_little(uint8_t *at, const int16_t *counts) {
  for (int k = 0; k < 3; k++) {
    at[2 * k] = counts[k] & 255;
    at[2 * k + 1] = (uint16_t)counts[k] >> 8;
  }
}

void put_big(uint8_t *at, const int16_t *counts) {
  for (int k = 0; k < 3; k++) {
    at[2 * k] = (uint16_t)counts[k] >> 8;
    at[2 * k + 1] = counts[k] & 255;
  }
}
