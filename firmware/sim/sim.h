// The emulated board: what its parts know of each other.  Times are real time [s] since power
// came; the controller's own clock is off by `skew`.
#pragma once

#include <simavr/sim_avr.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define CLOCK_HZ 16e6
#define MAX_IMUS 8

// board.c: the controller
extern avr_t *avr;
void board_load(const char *elf);
void board_reset(void);
void board_run_until(double instant);
double board_now(void);
void board_set_skew(double ppm);
avr_cycle_count_t board_cycles(double seconds);
avr_int_vector_t *board_vector(uint8_t number);
void board_take(uint16_t address, avr_io_read_t read, avr_io_write_t write);

// twi.c: its two-wire interface; uart.c: its first serial line
void twi_begin(void);
void twi_reset(void);
void uart_begin(void);
void uart_reset(void);
void uart_hear(const uint8_t *bytes, int count);

// lines.c: SDA and SCL as wires, moved by the pins or held by a fault
void lines_begin(void);
bool lines_sda_is_held(void);
void lines_stick(double seconds);
void lines_wedge(int imu);

// bus.c: the transactions on them, the multiplexer, the devices
void bus_start(void);
bool bus_address(uint8_t byte);
bool bus_write(uint8_t byte);
uint8_t bus_read(void);
void bus_stop(void);
double bus_stretch(void);
void bus_reset_mux(void);
bool bus_reaches(int channel);

// report.c: what was done wrong, how often, and when first
void violated(const char *format, ...) __attribute__((format(printf, 1, 2)));
void contended(const char *format, ...) __attribute__((format(printf, 1, 2)));
void report(const char *path);

// port.c: the pseudo-terminal; main.c decides where bytes go
void spoken(uint8_t byte);
void lose_spoken(double seconds);
bool port_open(const char *link);
bool port_is_read(void);
void port_write(const uint8_t *bytes, int count);
int port_read(uint8_t *bytes, int count);
void port_close(void);

// The run in numbers, for the report.
struct Totals {
  long bytes, dropped_bytes, transactions, refused, resets, overrun_bytes;
  long long opened_ns;  // host time of instant 0, where there is a port
  double behind;        // real time, at most [s]
};
extern struct Totals totals;
