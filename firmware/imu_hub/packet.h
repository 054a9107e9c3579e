// Packets as docs/wire_format.md says: fields, checks, stuffing.  Plain C++, tested on its own.
#pragma once

#include <stdint.h>

const uint8_t PROTOCOL = 1;
const uint8_t HELLO = 0x01, SCAN = 0x02, STATUS = 0x03, SYNC = 0x04;
const uint8_t HELLO_REQUEST = 0x11, SYNC_REQUEST = 0x12;
const uint8_t JUST_STARTED = 0, ASKED = 1;  // why a HELLO is sent

const uint8_t MAX_PACKET = 12 + 8 * 16;       // HELLO of eight IMUs
const uint8_t MAX_FRAME = MAX_PACKET + 4 + 2;  // two checks; a first code, a last zero
// One code is enough for 254 bytes, so a frame never needs another that is no zero's.
static_assert(MAX_PACKET + 4 < 254, "frames must be shorter");

// Writes fields one after the other, little-endian as this processor is.
struct PacketWriter {
  uint8_t *at;

  void u8(uint8_t value) { *at++ = value; }
  void u16(uint16_t value) {
    u8(value);
    u8(value >> 8);
  }
  void u32(uint32_t value) {
    u16(value);
    u16(value >> 16);
  }
  void f32(float value) {
    union {
      float number;
      uint32_t bits;
    } same = {value};
    u32(same.bits);
  }
};

// Stuff a packet and its checks into `frame`; return the frame's length with its zero.
uint8_t packet_frame(const uint8_t *packet, uint8_t length, uint8_t *frame);

// Undo that in place, for a frame without its zero; return the packet's length, or 0 if damaged.
uint8_t packet_unframe(uint8_t *frame, uint8_t length);
