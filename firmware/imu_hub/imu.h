// The board's IMUs: looked for, started, read, watched and, where one fails, looked for again.
#pragma once

#include <stdint.h>

#include "models.h"

const uint8_t MAX_IMUS = 8;

enum ImuState : uint8_t { ABSENT, STARTING, READY };

struct Imu {
  uint8_t channel, address;
  Model model;  // the last that was found there
  ImuState state;
  bool looked;             // all addresses have been tried
  uint8_t candidate;       // address that is tried next
  uint8_t step;            // of the start
  bool waiting;            // the step is written, not yet verified
  uint8_t failed_in_row;
  uint8_t repeats;         // of one reading
  uint16_t failures;       // modulo 2^16
  int16_t temperature;     // [0.01 Celsius]
  uint32_t due;            // when its start goes on [us]
  int16_t counts[COUNTS];  // last reading
};

extern Imu imus[MAX_IMUS];
extern const uint8_t imu_count;

void imus_begin();

// Say whether all places have been looked at.
bool imus_known();

// Say whether all places have an IMU that can be read.
bool imus_ready();

// Say, once, whether an IMU was found that was not there, or was another, before.
bool imus_changed();

// Read one IMU into its `counts`; false where there is nothing new.
bool imu_read(Imu &imu);

// Do at most one short thing for one IMU.  `rested` says that a scan has passed since the last
// call which said so: what is not urgent happens once a scan.
void imus_tend(bool rested);
