// The serial line: whole frames out, whole requests in.  Interrupts move the bytes; nothing waits.
#pragma once

#include <stdint.h>

#include "config.h"
#include "packet.h"

void uart_begin();

const uint8_t BYTE_US = 10 * 1000000UL / BAUD;
const uint8_t AROUND = 6;  // bytes of a frame around its packet

// Make a frame of a packet, false where there is no room; queue it to go at `instant` or later.
bool uart_frame(const uint8_t *packet, uint8_t length);
void uart_queue(uint32_t instant);

// Both at once, to go as soon as it can.
bool uart_send(const uint8_t *packet, uint8_t length);

// Let go what is due.
void uart_tend();

// Queue a packet before all that wait; false while another such waits.
bool uart_send_first(const uint8_t *packet, uint8_t length);

const uint8_t MAX_REQUEST = 16;  // [bytes] the longest, stuffed, has 11

struct Request {
  uint8_t bytes[MAX_REQUEST];
  uint8_t length;       // without the final zero
  uint32_t arrived_us;  // when the zero came
};

// Take the oldest request; false where there is none.
bool uart_receive(Request *request);
