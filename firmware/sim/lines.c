// SDA and SCL as wires: the sketch may move them by hand (pins 20 and 21 of the Mega, PD1 and
// PD0), and a fault may hold SDA low.
#include <simavr/avr_ioport.h>

#include "sim.h"

enum { PIND = 0x29, DDRD = 0x2A, PORTD = 0x2B, TWCR = 0xBC, TWEN = 0x04, SCL = 1, SDA = 2 };
enum { MUX_RESET_BIT = 5 };  // PG5, pin 4
#define CLOCKS_TO_END_A_BYTE 9

static double stuck_until = -1;
static int wedged_channel = -1, clocks_left;
static uint8_t level = SCL | SDA;  // as the sketch moves them
// What the simulator does with the three registers of the port.
static struct {
  avr_io_read_t read;
  avr_io_write_t write;
  void *read_argument, *write_argument;
} port[3];

bool lines_sda_is_held(void) {
  return board_now() < stuck_until || (clocks_left > 0 && bus_reaches(wedged_channel));
}

// Something shorts SDA to ground for so long.
void lines_stick(double seconds) {
  stuck_until = board_now() + seconds;
}

// A device on this channel has missed clocks in the middle of a byte, and waits for the rest.
void lines_wedge(int channel) {
  wedged_channel = channel;
  clocks_left = CLOCKS_TO_END_A_BYTE;
}

static void write_pins(avr_t *of, avr_io_addr_t address, uint8_t value, void *argument) {
  (void)argument;
  port[address - PIND].write(of, address, value, port[address - PIND].write_argument);
  const uint8_t out = avr->data[DDRD] & (SCL | SDA), high = out & avr->data[PORTD];
  if (high) contended("pins drive SDA or SCL high");
  if (avr->data[TWCR] & TWEN) {
    if (out & ~high) contended("pins pull SDA or SCL while the TWI has them");
    return;
  }
  const uint8_t before = level;
  level = (SCL | SDA) & ~(out & ~high);
  const bool fell = (before & SCL) && !(level & SCL);
  if (fell && clocks_left > 0 && bus_reaches(wedged_channel)) clocks_left--;
}

static uint8_t read_pins(avr_t *of, avr_io_addr_t address, void *argument) {
  (void)argument;
  const uint8_t others = port[0].read(of, address, port[0].read_argument) & ~(SCL | SDA);
  return others | (level & SCL) | (lines_sda_is_held() ? 0 : level & SDA);
}

static void on_mux_reset(struct avr_irq_t *irq, uint32_t value, void *argument) {
  (void)irq, (void)argument;
  if (!(value & 1)) bus_reset_mux();
}

void lines_begin(void) {
  for (int k = 0; k < 3; k++) {
    const avr_io_addr_t io = AVR_DATA_TO_IO(PIND + k);
    port[k].read = avr->io[io].r.c;
    port[k].read_argument = avr->io[io].r.param;
    port[k].write = avr->io[io].w.c;
    port[k].write_argument = avr->io[io].w.param;
  }
  board_take(PIND, read_pins, NULL);
  board_take(DDRD, NULL, write_pins);
  board_take(PORTD, NULL, write_pins);
  const uint32_t port_g = AVR_IOCTL_IOPORT_GETIRQ('G');
  avr_irq_register_notify(avr_io_getirq(avr, port_g, MUX_RESET_BIT), on_mux_reset, NULL);
}
