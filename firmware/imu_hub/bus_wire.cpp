// The two-wire interface through the Wire library: the default.
#include "config.h"

#if !BUS_POLLED

#include <Wire.h>

#include "bus_port.h"

void port_begin() {
  Wire.begin();
  Wire.setClock(BUS_CLOCK_HZ);
  // Called whether or not WIRE_HAS_TIMEOUT is defined: some cores have the one and not the other.
  Wire.setWireTimeout(BUS_PATIENCE_US, true);
}

void port_end() {
  Wire.end();
}

// A time-out at the final STOP is in the flag only: the call itself would report success.
static BusResult judge(uint8_t code) {
  if (Wire.getWireTimeoutFlag()) {
    Wire.clearWireTimeoutFlag();
    return BUS_STUCK;
  }
  if (code == 0) return BUS_OK;
  return code == 2 || code == 3 ? BUS_REFUSED : BUS_STUCK;
}

BusResult port_write(uint8_t address, const uint8_t *bytes, uint8_t count) {
  Wire.beginTransmission(address);
  Wire.write(bytes, count);
  return judge(Wire.endTransmission());
}

BusResult port_read(uint8_t address, uint8_t from, uint8_t *into, uint8_t count) {
  Wire.beginTransmission(address);
  Wire.write(from);
  BusResult result = judge(Wire.endTransmission(false));
  if (result != BUS_OK) return result;
  const uint8_t came = Wire.requestFrom(address, count);
  result = judge(0);
  if (result != BUS_OK) return result;
  if (came != count) return BUS_REFUSED;
  for (uint8_t k = 0; k < count; k++) into[k] = Wire.read();
  return BUS_OK;
}

#endif
