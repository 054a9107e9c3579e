// What both drivers of the two-wire interface have in common: bus_wire.cpp, bus_polled.cpp.
#pragma once

#include <stdint.h>

const uint16_t BUS_PATIENCE_US = 3000;  // a BNO055 may stretch the clock, but not that long

enum BusResult : uint8_t { BUS_OK, BUS_REFUSED, BUS_STUCK };

// Take the pins, or leave them to be moved by hand.
void port_begin();
void port_end();

BusResult port_write(uint8_t address, const uint8_t *bytes, uint8_t count);
BusResult port_read(uint8_t address, uint8_t from, uint8_t *into, uint8_t count);
