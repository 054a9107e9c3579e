// Runs the sketch's packet.cpp on this machine: one packet or frame in hexadecimal a line.
//   + PACKET   prints its frame
//   - FRAME    (without its zero) prints the packet in it, or nothing
#include <cstdio>
#include <cstring>

#include "packet.h"

static uint8_t read_hex(const char *text, uint8_t *bytes) {
  uint8_t count = 0;
  unsigned byte;
  for (; std::sscanf(text, "%2x", &byte) == 1; text += 2) bytes[count++] = byte;
  return count;
}

int main() {
  char line[1024];
  while (std::fgets(line, sizeof line, stdin)) {
    uint8_t bytes[256], frame[256], *out = frame;
    uint8_t count = read_hex(line + 2, bytes);
    if (line[0] == '+') {
      count = packet_frame(bytes, count, frame);
    } else {
      count = packet_unframe(bytes, count);
      out = bytes + 1;
    }
    for (uint8_t k = 0; k < count; k++) std::printf("%02x", out[k]);
    std::printf("\n");
  }
}
