// USART 0, which the Mega's USB chip is connected to; the core's Serial blocks when it is full.
#pragma GCC optimize("O2")  // the IDE optimises for size

#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "clock.h"

struct Frame {
  uint8_t bytes[MAX_FRAME];
  uint8_t length;
  uint32_t instant;  // not before
};

const uint8_t FRAMES = 4, REQUESTS = 4;  // powers of two

static Frame queue[FRAMES];
static uint8_t queued;  // counters that wrap
static volatile uint8_t due, sent;
static Frame first;
static volatile bool first_waits;
static const uint8_t *next_byte;
static volatile uint8_t bytes_left;

static Request requests[REQUESTS];
static volatile uint8_t received, taken;

void uart_begin() {
  UCSR0A = _BV(U2X0);
  UBRR0 = (F_CPU + 4UL * BAUD) / (8UL * BAUD) - 1;
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UCSR0B = _BV(RXCIE0) | _BV(RXEN0) | _BV(TXEN0);
}

static inline void begin(const Frame &frame) {
  next_byte = frame.bytes;
  bytes_left = frame.length;
}

ISR(USART0_UDRE_vect) {
  static bool first_goes;
  if (bytes_left == 0) {
    if (first_waits) {
      begin(first);
    } else if (due != sent) {
      begin(queue[sent % FRAMES]);
    } else {
      UCSR0B &= ~_BV(UDRIE0);
      return;
    }
    first_goes = first_waits;
  }
  UDR0 = *next_byte++;
  if (--bytes_left > 0) return;
  if (first_goes) {
    first_waits = false;
  } else {
    sent++;
  }
}

static void start() {
  const uint8_t status = SREG;
  cli();
  UCSR0B |= _BV(UDRIE0);
  SREG = status;
}

bool uart_frame(const uint8_t *packet, uint8_t length) {
  if ((uint8_t)(queued - sent) == FRAMES) return false;
  Frame &frame = queue[queued % FRAMES];
  frame.length = packet_frame(packet, length, frame.bytes);
  return true;
}

void uart_queue(uint32_t instant) {
  queue[queued % FRAMES].instant = instant;
  queued++;
  uart_tend();
}

bool uart_send(const uint8_t *packet, uint8_t length) {
  const bool framed = uart_frame(packet, length);
  if (framed) uart_queue(clock_us());
  return framed;
}

void uart_tend() {
  while (due != queued && clock_reached(queue[due % FRAMES].instant)) {
    due++;
    start();
  }
}

bool uart_send_first(const uint8_t *packet, uint8_t length) {
  if (first_waits) return false;
  first.length = packet_frame(packet, length, first.bytes);
  first_waits = true;
  start();
  return true;
}

ISR(USART0_RX_vect) {
  const uint8_t byte = UDR0;
  static uint8_t length;
  if ((uint8_t)(received - taken) == REQUESTS) {  // all places wait to be read
    length = MAX_REQUEST + 1;
  } else if (byte != 0) {
    // What is too long is no request; it is forgotten at its end.
    if (length < MAX_REQUEST) requests[received % REQUESTS].bytes[length] = byte;
    if (length <= MAX_REQUEST) length++;
    return;
  }
  if (byte != 0) return;
  if (length > 0 && length <= MAX_REQUEST) {
    Request &request = requests[received % REQUESTS];
    request.length = length;
    request.arrived_us = clock_us();
    received++;
  }
  length = 0;
}

bool uart_receive(Request *request) {
  if (received == taken) return false;
  *request = requests[taken % REQUESTS];
  taken++;
  return true;
}
