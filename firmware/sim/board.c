// The ATmega2560, the flashed sketch, and time.
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>

#include "sim.h"

avr_t *avr;
struct Totals totals;
static double cycles_per_second = CLOCK_HZ;

static void log_errors(avr_t *of, const int level, const char *format, va_list arguments) {
  (void)of;
  if (level <= LOG_ERROR) vfprintf(stderr, format, arguments);
}

void board_load(const char *elf) {
  static elf_firmware_t firmware;
  avr_global_logger_set(log_errors);
  if (elf_read_firmware(elf, &firmware) != 0) {
    fprintf(stderr, "Cannot read the sketch `%s`; build it with make.\n", elf);
    exit(2);
  }
  avr = avr_make_mcu_by_name("atmega2560");
  avr_init(avr);
  avr->frequency = CLOCK_HZ;
  avr_load_firmware(avr, &firmware);
  twi_begin();
  uart_begin();
  lines_begin();
  board_reset();
}

void board_reset(void) {
  avr_reset(avr);
  twi_reset();
  uart_reset();
}

void board_run_until(double instant) {
  const avr_cycle_count_t end = board_cycles(instant);
  while (avr->cycle < end) {
    avr->run_cycle_limit = 64;  // events happen that late at most; a larger one is hardly faster
    const int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) {
      fprintf(stderr, "The sketch crashed at %.6f s.\n", board_now());
      exit(3);
    }
  }
}

double board_now(void) {
  return avr->cycle / cycles_per_second;
}

void board_set_skew(double ppm) {
  cycles_per_second = CLOCK_HZ * (1 + 1e-6 * ppm);
}

avr_cycle_count_t board_cycles(double seconds) {
  return (avr_cycle_count_t)(seconds * cycles_per_second + 0.5);
}

avr_int_vector_t *board_vector(uint8_t number) {
  for (int k = 0; k < avr->interrupts.vector_count; k++) {
    if (avr->interrupts.vector[k]->vector == number) return avr->interrupts.vector[k];
  }
  fprintf(stderr, "The simulator has no interrupt %d.\n", number);
  exit(3);
}

// Put our behaviour in the place of the simulator's.
void board_take(uint16_t address, avr_io_read_t read, avr_io_write_t write) {
  const avr_io_addr_t io = AVR_DATA_TO_IO(address);
  if (read) avr->io[io].r.c = read;
  if (write) avr->io[io].w.c = write;
}
