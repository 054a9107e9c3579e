// The types of IMU that the board knows: how each is found, started, read and watched.
#pragma once

#include <stdint.h>

// As HELLO numbers them.
enum Model : uint8_t { UNKNOWN_MODEL = 0, BMI160 = 1, MPU9250 = 2, BNO055 = 3, SEN0140 = 4 };

const uint8_t COUNTS = 6;  // angular rate x, y, z, then specific force x, y, z
const int16_t UNKNOWN_TEMPERATURE = -32768;

// One step of a start: a register that is written, or looked at, or both.
enum StepKind : uint8_t {
  WRITE = 1,      // write it
  VERIFY = 2,     // after the wait, it must read as written
  WATCH = 4,      // and so it must ever after: else the IMU has lost its power for a moment
  COMPANION = 8,  // of the second chip
  COMMAND = WRITE,
  SET = WRITE | VERIFY,
};

struct Step {
  uint8_t reg, value, kind;
  uint8_t wait_ms;
};

struct ModelInfo {
  const Step *steps;  // in flash
  uint8_t step_count;
  uint16_t angular_rate_range, specific_force_range;  // [deg/s], [g]
  float angular_rate_scale, specific_force_scale;     // one count [rad/s], [m/s^2]
};

// Copy what is known of a model from flash.
void model_info(Model model, ModelInfo *info);

// Return who is at `address` of the connected channel, or UNKNOWN_MODEL.
Model model_at(uint8_t address);

// Read the six counts.
bool model_read(Model model, uint8_t address, int16_t *counts);

// Read the temperature [0.01 Celsius].
bool model_temperature(Model model, uint8_t address, int16_t *centi);

// Do the writing of a step; read what is in its register now.
bool step_write(const Step &step, uint8_t address);
bool step_read(const Step &step, uint8_t address, uint8_t *value);
