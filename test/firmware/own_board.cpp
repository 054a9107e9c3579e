// Stands in for another Arduino core, so that examples/own_board runs here: bytes to stdout for two
// seconds of its clock.  Requests come from stdin at half a second; reading 100 fails.
#include <cstdint>
#include <cstdio>
#include <vector>

static uint32_t now_us = 4294000000u;  // the clock wraps after one second

static uint32_t micros() {
  return now_us += 3;
}

struct {
  std::vector<uint8_t> coming;
  size_t taken;
  void begin(long) {}
  int available() { return now_us - 4294000000u > 500000 ? int(coming.size() - taken) : 0; }
  uint8_t read() { return coming[taken++]; }
  void write(const uint8_t *bytes, size_t count) { std::fwrite(bytes, 1, count, stdout); }
} Serial;

// Word k of reading n holds 100 n + k, less 20000.
struct {
  int readings, byte;
  void begin() {}
  void setClock(long) {}
  void beginTransmission(uint8_t) {}
  void write(uint8_t) {}
  int endTransmission(bool = true) { return 0; }
  int requestFrom(uint8_t, uint8_t count) {
    byte = 0;
    now_us += 400;
    return readings++ == 100 ? 0 : count;
  }
  int read() {
    const int16_t word = 100 * (readings - 1) + byte / 2 - 20000;
    return byte++ % 2 ? word & 255 : word >> 8 & 255;
  }
} Wire;

#include "own_board.ino"

int main() {
  for (int byte; (byte = std::getchar()) != EOF;) Serial.coming.push_back(byte);
  setup();
  while (now_us - 4294000000u < 2000000) loop();
}
