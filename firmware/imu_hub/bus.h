// The I2C bus with its multiplexer.  Nothing here waits longer than BUS_PATIENCE_US: what takes
// longer has stuck, and is recovered from between the scans.
#pragma once

#include <stdint.h>

void bus_begin();

// Connect one channel of the multiplexer, and no other; does nothing if it is connected.
bool bus_select(uint8_t channel);

// Read registers of a device, starting at register `from`.
bool bus_read(uint8_t address, uint8_t from, uint8_t *into, uint8_t count);

// Write one register of a device.
bool bus_write(uint8_t address, uint8_t to, uint8_t value);

// Say whether the bus can be used; while it is stuck, all calls above fail at once.
bool bus_is_usable();

// Try to free a stuck bus, if it is time to.
void bus_tend();

// Return how often that was tried, modulo 2^16.
uint16_t bus_recoveries();
