// The two-wire interface as a master.  The simulator's own takes 9 us a byte whatever the bit rate
// and never clears TWINT for a driver that polls; this one takes what SCL takes.
// ATmega2560 data sheet (Atmel 2549Q), chapter 24: bit rate 24.5.2, status tables 24-3 and 24-4.
#include "sim.h"

enum { TWBR = 0xB8, TWSR = 0xB9, TWDR = 0xBB, TWCR = 0xBC, TWI_VECTOR = 39 };
enum { TWINT = 0x80, TWEA = 0x40, TWSTA = 0x20, TWSTO = 0x10, TWWC = 0x08, TWEN = 0x04, TWIE = 1 };
enum { STARTED = 0x08, STARTED_AGAIN = 0x10, LOST = 0x38, NOTHING = 0xF8 };

static enum { IDLE, ADDRESSING, WRITING, READING } phase;
static enum { NO_OPERATION, START, SEND, RECEIVE, STOP } operation;
static bool owned;            // between START and STOP
static bool start_after_stop;
static uint8_t status = NOTHING;
static double stopped_at = -1;

static uint8_t control(void) {
  return avr->data[TWCR];
}

static double bit_time(void) {
  const int prescaler = 1 << 2 * (avr->data[TWSR] & 3);
  return (16 + 2 * avr->data[TWBR] * prescaler) / CLOCK_HZ;
}

static void finish(uint8_t new_status) {
  status = new_status;
  operation = NO_OPERATION;
  avr->data[TWCR] |= TWINT;
  avr_raise_interrupt(avr, board_vector(TWI_VECTOR));
}

static void end_start(void) {
  const bool again = owned;
  owned = true;
  bus_start();
  phase = ADDRESSING;
  avr->data[TWCR] &= ~TWSTA;
  finish(again ? STARTED_AGAIN : STARTED);
}

static void end_send(void) {
  const uint8_t byte = avr->data[TWDR];
  if (lines_sda_is_held() && byte != 0) {  // we said 1, and saw 0
    owned = false;
    phase = IDLE;
    finish(LOST);
  } else if (phase == ADDRESSING) {
    const bool read = byte & 1, heard = bus_address(byte);
    phase = read ? READING : WRITING;
    finish((read ? 0x40 : 0x18) + (heard ? 0 : 8));
  } else {
    finish(bus_write(byte) ? 0x28 : 0x30);
  }
}

static void end_receive(void) {
  avr->data[TWDR] = lines_sda_is_held() ? 0 : bus_read();
  finish(control() & TWEA ? 0x50 : 0x58);
}

static void begin(int what, double bits);

static void end_stop(void) {
  if (owned) bus_stop();
  owned = false;
  phase = IDLE;
  stopped_at = board_now();
  status = NOTHING;
  operation = NO_OPERATION;
  avr->data[TWCR] &= ~TWSTO;
  if (start_after_stop) begin(START, 2);
}

static avr_cycle_count_t on_time(avr_t *of, avr_cycle_count_t when, void *argument) {
  (void)of, (void)argument;
  // No START and no STOP can be made while somebody holds SDA.
  if ((operation == START || operation == STOP) && lines_sda_is_held()) {
    return when + board_cycles(bit_time());
  }
  switch (operation) {
    case START: end_start(); break;
    case SEND: end_send(); break;
    case RECEIVE: end_receive(); break;
    case STOP: end_stop(); break;
    default: break;
  }
  return 0;
}

static void begin(int what, double bits) {
  operation = what;
  double seconds = bits * bit_time();
  if (what == SEND || what == RECEIVE) seconds += bus_stretch();
  avr_cycle_timer_register(avr, board_cycles(seconds), on_time, NULL);
}

static void abandon(void) {
  avr_cycle_timer_cancel(avr, on_time, NULL);
  if (owned) bus_stop();
  owned = start_after_stop = false;
  phase = IDLE;
  operation = NO_OPERATION;
  status = NOTHING;
}

static void obey(uint8_t value) {
  status = NOTHING;
  start_after_stop = (value & TWSTO) && (value & TWSTA);
  if (value & TWSTO) {
    begin(STOP, 1);
  } else if (value & TWSTA) {
    // 1.3 us must pass after a STOP (I2C specification, table 10); the hardware sees to that.
    const bool soon = stopped_at >= 0 && board_now() - stopped_at < 1.3e-6;
    begin(START, soon ? 1.5 : 1);
  } else if (phase == ADDRESSING || phase == WRITING) {
    begin(SEND, 9);
  } else if (phase == READING) {
    begin(RECEIVE, 9);
  }
}

static void write_control(avr_t *of, avr_io_addr_t address, uint8_t value, void *argument) {
  (void)of, (void)argument;
  const bool flag = avr->data[address] & TWINT;
  const uint8_t kept = (flag && !(value & TWINT) ? TWINT : 0) | (avr->data[address] & TWWC);
  avr->data[address] = (value & (TWEA | TWSTA | TWSTO | TWEN | TWIE)) | kept;
  if (!(value & TWEN)) {
    abandon();
    avr_clear_interrupt(avr, board_vector(TWI_VECTOR));
    avr->data[address] &= ~(TWINT | TWSTO);
    return;
  }
  if (bit_time() < 2.5e-6 * 0.999) violated("SCL faster than 400 kHz");
  if (value & TWINT) {
    avr_clear_interrupt(avr, board_vector(TWI_VECTOR));
    avr->data[address] &= ~TWINT;
    if (operation != NO_OPERATION && flag) violated("TWI ordered while it works");
    if (operation == NO_OPERATION) obey(value);
  } else if (flag && (value & TWIE)) {
    avr_raise_interrupt(avr, board_vector(TWI_VECTOR));
  }
}

static void write_data(avr_t *of, avr_io_addr_t address, uint8_t value, void *argument) {
  (void)of, (void)argument;
  if (control() & TWINT) {
    avr->data[address] = value;
    avr->data[TWCR] &= ~TWWC;
  } else {
    avr->data[TWCR] |= TWWC;
    violated("TWDR written while TWINT is low");
  }
}

static uint8_t read_status(avr_t *of, avr_io_addr_t address, void *argument) {
  (void)of, (void)argument;
  return status | (avr->data[address] & 3);
}

static void write_status(avr_t *of, avr_io_addr_t address, uint8_t value, void *argument) {
  (void)of, (void)argument;
  avr->data[address] = value & 3;
}

void twi_begin(void) {
  board_take(TWCR, NULL, write_control);
  board_take(TWDR, NULL, write_data);
  board_take(TWSR, read_status, write_status);
}

void twi_reset(void) {
  abandon();
  avr->data[TWSR] = avr->data[TWCR] = avr->data[TWBR] = 0;
  avr->data[TWDR] = 0xFF;
}
