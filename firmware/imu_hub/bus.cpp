#include "bus.h"

#include <Arduino.h>

#include "bus_port.h"
#include "clock.h"
#include "config.h"

// The Mega's pins 20 and 21.
const uint8_t SDA_BIT = _BV(PD1), SCL_BIT = _BV(PD0), LINES = SDA_BIT | SCL_BIT;
const uint8_t HALF_CLOCK_US = 5;
const uint32_t RETRY_US = 20000;
const uint8_t UNKNOWN = 254;

static uint8_t selected = UNKNOWN;  // channel
static bool stuck;
static uint32_t retry_at;
static uint16_t recoveries;

static bool succeeded(BusResult result) {
  if (result == BUS_STUCK) {
    stuck = true;
    retry_at = clock_us();
  }
  if (result != BUS_OK) selected = UNKNOWN;
  return result == BUS_OK;
}

void bus_begin() {
#if MUX_RESET_PIN >= 0
  digitalWrite(MUX_RESET_PIN, HIGH);
  pinMode(MUX_RESET_PIN, OUTPUT);
#endif
  port_begin();
}

bool bus_select(uint8_t channel) {
  if (stuck) return false;
  if (channel == selected || channel == NO_MUX) return true;
  const uint8_t mask = 1 << channel;
  if (!succeeded(port_write(MUX_ADDRESS, &mask, 1))) return false;
  selected = channel;
  return true;
}

bool bus_read(uint8_t address, uint8_t from, uint8_t *into, uint8_t count) {
  return !stuck && succeeded(port_read(address, from, into, count));
}

bool bus_write(uint8_t address, uint8_t to, uint8_t value) {
  const uint8_t bytes[] = {to, value};
  return !stuck && succeeded(port_write(address, bytes, sizeof bytes));
}

bool bus_is_usable() {
  return !stuck;
}

uint16_t bus_recoveries() {
  return recoveries;
}

// Pull lines low, or let go of them; PORTD stays 0, so that they are never driven high.
static void pull(uint8_t lines) {
  DDRD = (DDRD & ~LINES) | lines;
  delayMicroseconds(HALF_CLOCK_US);
}

static void reset_mux() {
#if MUX_RESET_PIN >= 0
  digitalWrite(MUX_RESET_PIN, LOW);  // 6 ns would do: TCA9548A data sheet (SCPS207), section 6.6
  digitalWrite(MUX_RESET_PIN, HIGH);
#endif
  selected = UNKNOWN;
}

// A device that was interrupted in the middle of a byte waits for up to nine clocks, then for a
// STOP (NXP UM10204, section 3.1.16).  Its way to us must stay open until then.
static void clock_out() {
  for (uint8_t k = 0; k < 9 && !(PIND & SDA_BIT); k++) {
    pull(SCL_BIT);
    pull(0);
  }
  pull(SCL_BIT);
  pull(LINES);
  pull(SDA_BIT);
  pull(0);
}

void bus_tend() {
  if (!stuck || !clock_reached(retry_at)) return;
  recoveries++;
  port_end();
  PORTD &= ~LINES;
  clock_out();
  reset_mux();
  stuck = (PIND & LINES) != LINES;
  retry_at = clock_us() + RETRY_US;
  port_begin();
}
