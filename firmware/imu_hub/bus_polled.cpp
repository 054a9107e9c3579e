// The two-wire interface without interrupts and copies: the loop waits for each byte.
// Status codes: ATmega2560 data sheet (Atmel 2549), chapter 24, tables 24-3 and 24-4.
#pragma GCC optimize("O2")  // the IDE optimises for size

#include "config.h"

#if BUS_POLLED

#include <avr/io.h>

#include "bus_port.h"

const uint8_t STARTED = 0x08, STARTED_AGAIN = 0x10;
const uint8_t WRITE_HEARD = 0x18, BYTE_HEARD = 0x28, READ_HEARD = 0x40;
const uint8_t BYTE_CAME = 0x50, LAST_BYTE_CAME = 0x58;
const uint8_t BUS_ERROR = 0x00, ARBITRATION_LOST = 0x38;
// In turns of a loop, of about ten cycles.
const uint16_t PATIENCE = BUS_PATIENCE_US / 1000 * (F_CPU / 1000 / 10);

void port_begin() {
  TWSR = 0;
  TWBR = (F_CPU / BUS_CLOCK_HZ - 16) / 2;
  TWCR = _BV(TWEN);
}

void port_end() {
  TWCR = 0;
}

// Let the interface do its next thing; return its status, or BUS_ERROR if it never ends.
static inline uint8_t issue(uint8_t what) {
  TWCR = what | _BV(TWINT) | _BV(TWEN);
  for (uint16_t left = PATIENCE; !(TWCR & _BV(TWINT)); left--) {
    if (left == 0) return BUS_ERROR;
  }
  return TWSR;
}

static inline uint8_t send(uint8_t byte) {
  TWDR = byte;
  return issue(0);
}

static BusResult stop(BusResult result) {
  TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
  for (uint16_t left = PATIENCE; TWCR & _BV(TWSTO); left--) {
    if (left == 0) return BUS_STUCK;
  }
  return result;
}

// End what went wrong: without a STOP where the bus is not ours.
static BusResult give_up(uint8_t status) {
  if (status == BUS_ERROR || status == ARBITRATION_LOST) return BUS_STUCK;
  return stop(BUS_REFUSED);
}

static uint8_t address_device(uint8_t address, uint8_t read) {
  const uint8_t status = issue(_BV(TWSTA));
  if (status != STARTED && status != STARTED_AGAIN) return BUS_ERROR;
  return send(address << 1 | read);
}

BusResult port_write(uint8_t address, const uint8_t *bytes, uint8_t count) {
  uint8_t status = address_device(address, 0);
  if (status != WRITE_HEARD) return give_up(status);
  for (uint8_t k = 0; k < count; k++) {
    status = send(bytes[k]);
    if (status != BYTE_HEARD) return give_up(status);
  }
  return stop(BUS_OK);
}

BusResult port_read(uint8_t address, uint8_t from, uint8_t *into, uint8_t count) {
  uint8_t status = address_device(address, 0);
  if (status != WRITE_HEARD) return give_up(status);
  status = send(from);
  if (status != BYTE_HEARD) return give_up(status);
  status = address_device(address, 1);
  if (status != READ_HEARD) return give_up(status);
  for (; count > 1; count--) {
    status = issue(_BV(TWEA));
    if (status != BYTE_CAME) return give_up(status);
    *into++ = TWDR;
  }
  status = issue(0);
  if (status != LAST_BYTE_CAME) return give_up(status);
  *into = TWDR;
  return stop(BUS_OK);
}

#endif
