// USART 0.  The simulator's own counts 11 bits a byte and forgets UDRE once TXEN drops.
// ATmega2560 data sheet (Atmel 2549Q), chapter 22.
#include "sim.h"

enum { UCSRA = 0xC0, UCSRB = 0xC1, UBRRL = 0xC4, UBRRH = 0xC5, UDR = 0xC6 };
enum { RXC = 0x80, TXC = 0x40, UDRE = 0x20, OVERRUN = 0x08, U2X = 0x02 };
enum { RXEN = 0x10, TXEN = 0x08 };
enum { RX_VECTOR = 25, UDRE_VECTOR = 26, TX_VECTOR = 27 };
#define HOST_BAUD 500000.0
#define BITS 10

static bool shifting, waiting;  // a byte on the line, and one behind it
static uint8_t on_line, behind;
static uint8_t heard[2];        // the two bytes that the hardware keeps
static int heard_count;
static uint8_t coming[4096];
static int coming_from, coming_count;

static double baud(void) {
  const int divider = avr->data[UBRRL] + 256 * (avr->data[UBRRH] & 15) + 1;
  return CLOCK_HZ / ((avr->data[UCSRA] & U2X ? 8 : 16) * divider);
}

static void offer(void) {
  avr->data[UCSRA] |= UDRE;
  avr_raise_interrupt(avr, board_vector(UDRE_VECTOR));
}

static avr_cycle_count_t on_sent(avr_t *of, avr_cycle_count_t when, void *argument) {
  (void)of, (void)argument;
  spoken(on_line);
  shifting = waiting;
  if (!waiting) {
    avr->data[UCSRA] |= TXC;
    return 0;
  }
  on_line = behind;
  waiting = false;
  offer();
  return when + (avr_cycle_count_t)(BITS * CLOCK_HZ / baud());
}

static void write_data(avr_t *of, avr_io_addr_t address, uint8_t value, void *argument) {
  (void)of, (void)address, (void)argument;
  if (!(avr->data[UCSRB] & TXEN)) return;
  if (waiting) {
    violated("UDR0 written while it was full");
  } else if (shifting) {
    behind = value;
    waiting = true;
    avr->data[UCSRA] &= ~UDRE;
    avr_clear_interrupt(avr, board_vector(UDRE_VECTOR));
    avr->data[UCSRA] &= ~UDRE;
  } else {
    const double error = baud() / HOST_BAUD - 1;
    if (error > 0.02 || error < -0.02) violated("baud rate off by more than 2 %%");
    shifting = true;
    on_line = value;
    avr_cycle_timer_register(avr, (avr_cycle_count_t)(BITS * CLOCK_HZ / baud()), on_sent, NULL);
    offer();
  }
}

static uint8_t read_data(avr_t *of, avr_io_addr_t address, void *argument) {
  (void)of, (void)address, (void)argument;
  const uint8_t byte = heard[0];
  if (heard_count > 0) {
    heard[0] = heard[1];
    heard_count--;
  }
  avr->data[UCSRA] &= ~OVERRUN;
  avr_clear_interrupt(avr, board_vector(RX_VECTOR));
  avr->data[UCSRA] &= ~RXC;
  if (heard_count > 0) {
    avr->data[UCSRA] |= RXC;
    avr_raise_interrupt(avr, board_vector(RX_VECTOR));
  }
  return byte;
}

static void write_control(avr_t *of, avr_io_addr_t address, uint8_t value, void *argument) {
  (void)of, (void)argument;
  avr->data[address] = value;
  // Both are levels: whoever enables the interrupt late still gets it.
  if (avr->data[UCSRA] & UDRE) offer();
  if (avr->data[UCSRA] & RXC) avr_raise_interrupt(avr, board_vector(RX_VECTOR));
}

static void write_status(avr_t *of, avr_io_addr_t address, uint8_t value, void *argument) {
  (void)of, (void)argument;
  const uint8_t own = RXC | TXC | UDRE | OVERRUN;
  avr->data[address] = (avr->data[address] & own) | (value & ~own);
  if (value & TXC) avr->data[address] &= ~TXC;
}

static avr_cycle_count_t on_heard(avr_t *of, avr_cycle_count_t when, void *argument) {
  (void)of, (void)argument;
  const uint8_t byte = coming[coming_from++ % sizeof coming];
  coming_count--;
  if (avr->data[UCSRB] & RXEN) {
    if (heard_count == 2) {
      totals.overrun_bytes++;
      avr->data[UCSRA] |= OVERRUN;
    } else {
      heard[heard_count++] = byte;
      avr->data[UCSRA] |= RXC;
      avr_raise_interrupt(avr, board_vector(RX_VECTOR));
    }
  }
  return coming_count > 0 ? when + board_cycles(BITS / HOST_BAUD) : 0;
}

// The host's bytes come at its own pace.
void uart_hear(const uint8_t *bytes, int count) {
  const bool idle = coming_count == 0;
  for (int k = 0; k < count && coming_count < (int)sizeof coming; k++) {
    coming[(coming_from + coming_count++) % sizeof coming] = bytes[k];
  }
  if (idle && count > 0) {
    avr_cycle_timer_register(avr, board_cycles(BITS / HOST_BAUD), on_heard, NULL);
  }
}

void uart_begin(void) {
  board_take(UDR, read_data, write_data);
  board_take(UCSRB, NULL, write_control);
  board_take(UCSRA, NULL, write_status);
  avr->io[AVR_DATA_TO_IO(UCSRA)].r.c = NULL;
}

void uart_reset(void) {
  avr_cycle_timer_cancel(avr, on_sent, NULL);
  avr_cycle_timer_cancel(avr, on_heard, NULL);
  shifting = waiting = false;
  heard_count = coming_count = coming_from = 0;
  avr->data[UCSRA] = UDRE;
  avr->data[UCSRB] = 0;
}
