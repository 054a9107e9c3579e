// An emulated sensor chip: registers, times, faults.
#pragma once

#include "sim.h"

#define NO_CHANNEL 255
#define GRAVITY 9.80665
#define DEGREE 0.017453292519943295
#define TEMPERATURE 26.0  // [Celsius]

struct Device;

struct Kind {
  const char *name;
  void (*power_up)(struct Device *);
  bool (*answers)(struct Device *);  // may be NULL: always
  void (*write)(struct Device *, uint8_t reg, uint8_t value);
  uint8_t (*read)(struct Device *, uint8_t reg);
  void (*latch)(struct Device *, uint8_t reg);  // a read begins here; may be NULL
  double stretch;                               // of SCL, before an answer [s]
};

struct Device {
  const struct Kind *kind;
  int imu, channel;
  uint8_t address;
  // faults
  bool dead, frozen, frozen_for_good;
  int refuse_every, asked;
  double frozen_at;
  // state
  uint8_t reg[256];
  uint8_t pointer;
  bool pointing;       // the next byte written is a register's number
  double powered_at, written_at, busy_until;
  double ready_at[2];  // accelerometer, gyroscope
  uint8_t page;        // of a BNO055
};

extern struct Device devices[2 * MAX_IMUS];
extern int device_count;

void device_add(int imu, const char *kind, int channel, int address);
void device_power_up(struct Device *device);
void device_fault(int imu, const char *what, int number);

// Fill angular rate and specific force as the device has them now; scales are SI per count, or 0
// for what it does not measure.
void device_sample(struct Device *device, double rate_hz, double angular_rate_scale,
                   double specific_force_scale, int limit, int16_t counts[6]);
void put_little(uint8_t *at, const int16_t *counts);
void put_big(uint8_t *at, const int16_t *counts);

// motion.c
void motion_choose(const char *kind, const char *path);
bool motion_counts(int imu, long n, int16_t counts[6]);
void motion_at(int imu, long n, double t, double values[6]);

extern const struct Kind BMI160, MPU9250, MPU9255, BNO055, ADXL345, ITG3200;
