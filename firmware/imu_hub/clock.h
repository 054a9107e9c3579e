// The board's time: microseconds since its start in 32 bits, which wrap after 71.6 minutes.
#pragma once

#include <stdint.h>

void clock_begin();

// Return the present instant [us]; may be called from an interrupt.
uint32_t clock_us();

// Say whether `instant` has come; right while it is less than 35 minutes away.
inline bool clock_reached(uint32_t instant) {
  return (int32_t)(clock_us() - instant) >= 0;
}
