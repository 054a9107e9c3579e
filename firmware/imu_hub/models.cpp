// Registers and times of the devices; the table of each names its data sheet.
#include "models.h"

#include <avr/pgmspace.h>

#include "bus.h"
#include "config.h"

const float RAD_PER_DEG = 0.017453292519943295f;
const float STANDARD_GRAVITY = 9.80665f;

// Pick by the range at compile time.
constexpr uint8_t by_rate(uint8_t dps250, uint8_t dps500, uint8_t dps1000, uint8_t dps2000) {
  return ANGULAR_RATE_RANGE_DPS == 250   ? dps250
         : ANGULAR_RATE_RANGE_DPS == 500 ? dps500
         : ANGULAR_RATE_RANGE_DPS == 1000 ? dps1000
                                          : dps2000;
}

constexpr uint8_t by_force(uint8_t g2, uint8_t g4, uint8_t g8, uint8_t g16) {
  return FORCE_RANGE_G == 2 ? g2 : FORCE_RANGE_G == 4 ? g4 : FORCE_RANGE_G == 8 ? g8 : g16;
}

static_assert(ANGULAR_RATE_RANGE_DPS == 250 || ANGULAR_RATE_RANGE_DPS == 500 ||
                  ANGULAR_RATE_RANGE_DPS == 1000 || ANGULAR_RATE_RANGE_DPS == 2000,
              "ANGULAR_RATE_RANGE_DPS must be 250, 500, 1000 or 2000");
static_assert(FORCE_RANGE_G == 2 || FORCE_RANGE_G == 4 || FORCE_RANGE_G == 8 ||
                  FORCE_RANGE_G == 16,
              "FORCE_RANGE_G must be 2, 4, 8 or 16");

// All that can sample at 200 to 500 Hz, so that each scan reads something new, with a bandwidth of
// about 40 Hz, or 90 Hz for faster scans, so that little noise folds down.
constexpr uint8_t by_scans(uint8_t slow, uint8_t fast) {
  return SCAN_RATE_HZ <= 100 ? slow : fast;
}
static_assert(SCAN_RATE_HZ <= 400, "SCAN_RATE_HZ must be at most 400: a BMI160 samples as fast");

// Bosch BST-BMI160-DS000-07, section 2.11 (registers), tables 2 and 3 (start-up times, scales)
const Step BMI160_STEPS[] PROGMEM = {
    {0x7E, 0xB6, COMMAND, 20},                         // CMD: soft reset
    {0x7E, 0x11, COMMAND, 5},                          // CMD: accelerometer on; 3.8 ms
    {0x7E, 0x15, COMMAND, 85},                         // CMD: gyroscope on; 80 ms
    {0x40, by_scans(0x0A, 0x1A), SET, 0},              // ACC_CONF: 400 Hz, oversampled 4 or 2-fold
    {0x41, by_force(0x03, 0x05, 0x08, 0x0C), SET, 0},  // ACC_RANGE
    {0x42, by_scans(0x0A, 0x1A), SET, 0},              // GYR_CONF: the same
    {0x43, by_rate(3, 2, 1, 0), SET, 0},               // GYR_RANGE
    {0x03, 0x14, VERIFY | WATCH, 0},                   // PMU_STATUS: both in normal mode
};

// InvenSense RM-MPU-9250A-00 rev. 1.4, pages 9, 11 (2^16 counts for 500 deg/s), 12-14;
// PS-MPU-9250A-01 rev. 1.0, pages 8, 12
const Step MPU9250_STEPS[] PROGMEM = {
    {0x6B, 0x80, COMMAND, 105},                                // PWR_MGMT_1: reset; 100 ms
    {0x6B, 0x01, SET, 40},                                     // clock of the gyroscopes; 35 ms
    {0x1A, by_scans(3, 2), SET, 0},                            // CONFIG: rate 41 or 92 Hz wide
    {0x19, 0x01, SET, 0},                                      // SMPLRT_DIV: 500 Hz
    {0x1B, by_rate(0x00, 0x08, 0x10, 0x18), SET | WATCH, 0},   // GYRO_CONFIG
    {0x1C, by_force(0x00, 0x08, 0x10, 0x18), SET | WATCH, 0},  // ACCEL_CONFIG
    {0x1D, by_scans(3, 2), SET, 0},                            // ACCEL_CONFIG_2: 45 or 99 Hz wide
};

// Bosch BST-BNO055-DS000-14 rev. 1.4, pages 21 (modes), 27-28 (settings), 53 (data), 91 (bus)
const Step BNO055_STEPS[] PROGMEM = {
    {0x07, 0x00, COMMAND, 0},                                     // PAGE_ID: where OPR_MODE is
    {0x3D, 0x00, COMMAND, 20},                                    // OPR_MODE: CONFIG; 19 ms
    {0x07, 0x01, COMMAND, 0},                                     // PAGE_ID: the sensors' settings
    {0x08, by_scans(0x0C, 0x10) | by_force(0, 1, 2, 3), SET, 0},  // ACC_Config: 62.5 or 125 Hz
    {0x0A, by_scans(0x18, 0x10) | by_rate(3, 2, 1, 0), SET, 0},   // GYR_Config_0: 47 or 116 Hz
    {0x07, 0x00, COMMAND, 0},                                     // PAGE_ID: back to the data
    {0x3B, 0x00, SET, 0},                                         // UNIT_SEL: SI, deg/s, Celsius
    {0x3D, 0x07, SET | WATCH, 10},                                // OPR_MODE: AMG; 7 ms
};

// Analog Devices ADXL345 rev. D, pages 13 (power) and 23-27 (registers)
// InvenSense PS-ITG-3200A-00-01.4, pages 7 (scale, start-up), 18 (bus) and 22-27 (registers)
const Step SEN0140_STEPS[] PROGMEM = {
    {0x3E, 0x80, COMMAND, 50},                                // PWR_MGM: reset
    {0x2D, 0x00, SET | COMPANION, 0},                         // POWER_CTL: standby
    {0x2C, 0x0B, SET | COMPANION, 0},                         // BW_RATE: 200 Hz
    {0x31, 0x08 | by_force(0, 1, 2, 3), SET | COMPANION, 0},  // DATA_FORMAT: full resolution
    {0x2D, 0x08, SET | COMPANION | WATCH, 20},                // POWER_CTL: measure
    {0x3E, 0x01, SET, 70},                                    // PWR_MGM: clock from the X gyro
    {0x15, 0x01, SET, 0},                                     // SMPLRT_DIV: 500 Hz
    {0x16, by_scans(0x1B, 0x1A), SET | WATCH, 0},             // DLPF_FS: FS_SEL 3, 42 or 98 Hz
};

#define STEPS(table) table, sizeof table / sizeof table[0]

const ModelInfo INFOS[] PROGMEM = {
    {STEPS(BMI160_STEPS), ANGULAR_RATE_RANGE_DPS, FORCE_RANGE_G,
     RAD_PER_DEG / 16.4f * ANGULAR_RATE_RANGE_DPS / 2000,
     STANDARD_GRAVITY / 16384 * FORCE_RANGE_G / 2},
    {STEPS(MPU9250_STEPS), ANGULAR_RATE_RANGE_DPS, FORCE_RANGE_G,
     RAD_PER_DEG * ANGULAR_RATE_RANGE_DPS / 32768,
     STANDARD_GRAVITY / 16384 * FORCE_RANGE_G / 2},
    {STEPS(BNO055_STEPS), ANGULAR_RATE_RANGE_DPS, FORCE_RANGE_G, RAD_PER_DEG / 16, 0.01f},
    {STEPS(SEN0140_STEPS), 2000, FORCE_RANGE_G, RAD_PER_DEG / 14.375f, STANDARD_GRAVITY / 256},
};

const uint8_t ADXL345_ADDRESS = 0x53;

void model_info(Model model, ModelInfo *info) {
  memcpy_P(info, &INFOS[model - 1], sizeof *info);
}

static bool reads(uint8_t address, uint8_t reg, uint8_t value) {
  uint8_t found;
  return bus_read(address, reg, &found, 1) && found == value;
}

static Model model_at_gyro_address(uint8_t address) {
  uint8_t id;
  // First, for register 0 of an MPU holds a factory value that may be anyone's id.
  if (!bus_read(address, 0x75, &id, 1)) return UNKNOWN_MODEL;
  if (id == 0x71 || id == 0x73) return MPU9250;  // MPU-9250, MPU-9255
  if (!bus_read(address, 0x00, &id, 1)) return UNKNOWN_MODEL;
  if (id == 0xD1) return BMI160;
  const bool itg3200 = (id & 0x7E) == 0x68;
  return itg3200 && reads(ADXL345_ADDRESS, 0x00, 0xE5) ? SEN0140 : UNKNOWN_MODEL;
}

Model model_at(uint8_t address) {
  if (address == 0x68 || address == 0x69) return model_at_gyro_address(address);
  // The id is on page 0; whoever was interrupted may have left page 1.
  const bool asked = bus_write(address, 0x07, 0x00);
  return asked && reads(address, 0x00, 0xA0) ? BNO055 : UNKNOWN_MODEL;
}

static void little_endian(const uint8_t *bytes, int16_t *counts) {
  for (uint8_t k = 0; k < 3; k++) counts[k] = bytes[2 * k] | bytes[2 * k + 1] << 8;
}

static void big_endian(const uint8_t *bytes, int16_t *counts) {
  for (uint8_t k = 0; k < 3; k++) counts[k] = bytes[2 * k] << 8 | bytes[2 * k + 1];
}

bool model_read(Model model, uint8_t address, int16_t *counts) {
  uint8_t bytes[18];
  switch (model) {
    case BMI160:  // gyroscope, accelerometer: exactly what is wanted
      return bus_read(address, 0x0C, (uint8_t *)counts, 12);
    case MPU9250:  // accelerometer, temperature, gyroscope
      if (!bus_read(address, 0x3B, bytes, 14)) return false;
      big_endian(bytes + 8, counts);
      big_endian(bytes, counts + 3);
      return true;
    case BNO055:  // accelerometer, magnetometer, gyroscope
      if (!bus_read(address, 0x08, bytes, 18)) return false;
      little_endian(bytes + 12, counts);
      little_endian(bytes, counts + 3);
      return true;
    case SEN0140:
      if (!bus_read(address, 0x1D, bytes, 6)) return false;
      if (!bus_read(ADXL345_ADDRESS, 0x32, bytes + 6, 6)) return false;
      big_endian(bytes, counts);
      little_endian(bytes + 6, counts + 3);
      return true;
    default:
      return false;
  }
}

bool model_temperature(Model model, uint8_t address, int16_t *centi) {
  uint8_t bytes[2];
  int16_t raw;
  switch (model) {
    case BMI160:  // 23 + raw / 512 Celsius
      if (!bus_read(address, 0x20, bytes, 2)) return false;
      raw = bytes[0] | bytes[1] << 8;
      *centi = raw == -32768 ? UNKNOWN_TEMPERATURE : 2300 + (int32_t)raw * 25 / 128;
      return true;
    case MPU9250:  // 21 + raw / 333.87
      if (!bus_read(address, 0x41, bytes, 2)) return false;
      raw = bytes[0] << 8 | bytes[1];
      *centi = 2100 + (int32_t)raw * 10000 / 33387;
      return true;
    case BNO055:
      if (!bus_read(address, 0x34, bytes, 1)) return false;
      *centi = (int8_t)bytes[0] * 100;
      return true;
    case SEN0140:  // 35 + (raw + 13200) / 280
      if (!bus_read(address, 0x1B, bytes, 2)) return false;
      raw = bytes[0] << 8 | bytes[1];
      *centi = 3500 + ((int32_t)raw + 13200) * 5 / 14;
      return true;
    default:
      return false;
  }
}

static uint8_t chip(const Step &step, uint8_t address) {
  return step.kind & COMPANION ? ADXL345_ADDRESS : address;
}

bool step_write(const Step &step, uint8_t address) {
  return !(step.kind & WRITE) || bus_write(chip(step, address), step.reg, step.value);
}

bool step_read(const Step &step, uint8_t address, uint8_t *value) {
  return bus_read(chip(step, address), step.reg, value, 1);
}
