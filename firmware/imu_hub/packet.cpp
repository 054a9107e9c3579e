#pragma GCC optimize("O2")  // the IDE optimises for size

#include "packet.h"

#ifdef __AVR__
#include <util/crc16.h>
#else
static uint16_t _crc_xmodem_update(uint16_t crc, uint8_t byte) {
  crc ^= byte << 8;
  for (uint8_t k = 0; k < 8; k++) crc = crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1;
  return crc;
}
#endif

// The two checks over a packet; the CRC goes over the sum, too.
struct Checks {
  uint16_t a = 1, sum = 0, crc = 0xFFFF;

  // A packet is so short that `a` never comes near 65521; only `sum` is taken modulo that.
  void add(uint8_t byte) {
    a += byte;
    const uint16_t before = sum;
    sum += a;
    if (sum < before || sum >= 65521u) sum -= 65521u;
    crc = _crc_xmodem_update(crc, byte);
  }

  void add_sum() {
    crc = _crc_xmodem_update(crc, sum);
    crc = _crc_xmodem_update(crc, sum >> 8);
  }
};

// Writes bytes between codes that say how far the next zero is.
struct Stuffing {
  uint8_t *at, *code;

  explicit Stuffing(uint8_t *frame) : at(frame + 1), code(frame) {}

  void add(uint8_t byte) {
    if (byte) {
      *at++ = byte;
    } else {
      *code = at - code;
      code = at++;
    }
  }
};

uint8_t packet_frame(const uint8_t *packet, uint8_t length, uint8_t *frame) {
  Checks checks;
  Stuffing stuffing(frame);
  for (; length > 0; length--) {
    checks.add(*packet);
    stuffing.add(*packet++);
  }
  checks.add_sum();
  stuffing.add(checks.sum);
  stuffing.add(checks.sum >> 8);
  stuffing.add(checks.crc);
  stuffing.add(checks.crc >> 8);
  stuffing.add(0);  // ends the last run
  stuffing.at[-1] = 0;
  return stuffing.at - frame;
}

uint8_t packet_unframe(uint8_t *frame, uint8_t length) {
  uint8_t zero_at = 0;
  for (uint8_t k = 0; k < length; k++) {
    if (k != zero_at) continue;
    if (frame[k] == 0 || frame[k] > length - k) return 0;
    zero_at = k + frame[k];
    frame[k] = 0;
  }
  if (zero_at != length || length < 1 + 1 + 4) return 0;
  Checks checks;
  const uint8_t end = length - 4;
  for (uint8_t k = 1; k < end; k++) checks.add(frame[k]);
  checks.add_sum();
  const uint16_t sum = frame[end] | frame[end + 1] << 8;
  const uint16_t crc = frame[end + 2] | frame[end + 3] << 8;
  return sum == checks.sum && crc == checks.crc ? end - 1 : 0;
}
