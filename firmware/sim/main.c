// imu_hub_sim: runs the compiled sketch on an emulated board.
//
//   imu_hub_sim SKETCH.elf SCRIPT > BYTES        as fast as it goes, and the same each time
//   imu_hub_sim SKETCH.elf SCRIPT --port LINK    in real time, on a pseudo-terminal
//
// With --report FILE the report does not go to stderr; with --ends FILE the instant of each zero
// goes there [s].
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "script.h"
#include "sim.h"

#define SLICE 1e-3  // [s] of the real-time run

static const char *port;
static FILE *ends;
static uint8_t said[4096];  // since the last look at the port
static int said_count;
static double lose_until;
static volatile sig_atomic_t interrupted;

void spoken(uint8_t byte) {
  totals.bytes++;
  if (ends && byte == 0) fprintf(ends, "%.7f\n", board_now());
  if (board_now() < lose_until) {
    totals.dropped_bytes++;
  } else if (!port) {
    putchar(byte);
  } else if (said_count < (int)sizeof said) {
    said[said_count++] = byte;
  }
}

// The Mega's USB chip has a small buffer, and throws away what a stalled host does not fetch.
void lose_spoken(double seconds) {
  lose_until = board_now() + seconds;
}

static void on_signal(int number) {
  (void)number;
  interrupted = 1;
}

static double monotonic(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

static void sleep_until(double instant) {
  const struct timespec time = {(time_t)instant, (long)(fmod(instant, 1) * 1e9)};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, NULL);
}

// What happens is told with the host's time, as the port's reader may be judged by it.
static void tell(const char *what) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  printf("%lld %s\n", now.tv_sec * 1000000000LL + now.tv_nsec, what);
  fflush(stdout);
}

static void run_script(void) {
  while (isfinite(script_next())) {
    board_run_until(script_next());
    if (!script_act()) return;
  }
}

// Run until the instant, with what happens before it; false at the end of the script.
static bool run_slice(double end) {
  while (script_next() <= end) {
    board_run_until(script_next());
    tell(script_what());
    if (!script_act()) return false;
  }
  board_run_until(end);
  return true;
}

static void exchange(void) {
  uint8_t bytes[512];
  if (port_is_read()) port_write(said, said_count);
  said_count = 0;
  uart_hear(bytes, port_read(bytes, sizeof bytes));
}

// Time begins when the port is first opened; each opening resets the controller, as the Mega does.
static void run_port(void) {
  // It stands for hardware, which nobody else's work delays; where that is not allowed, it may.
  const struct sched_param first = {.sched_priority = 1};
  sched_setscheduler(0, SCHED_RR, &first);
  while (!port_is_read() && !interrupted) sleep_until(monotonic() + 10 * SLICE);
  const double start = monotonic();
  struct timespec opened;
  clock_gettime(CLOCK_REALTIME, &opened);
  totals.opened_ns = opened.tv_sec * 1000000000LL + opened.tv_nsec;
  tell("open");
  bool was_read = true;
  for (double end = SLICE; !interrupted; end += SLICE) {
    const bool is_read = port_is_read();
    if (is_read && !was_read) {
      totals.resets++;
      board_reset();
    }
    was_read = is_read;
    if (!run_slice(end)) break;
    exchange();
    const double behind = monotonic() - start - end;
    if (behind > totals.behind) totals.behind = behind;
    sleep_until(start + end);
  }
  // Closing throws away what has not been read yet.
  for (int k = 0; k < 200 && port_is_read() && !interrupted; k++) sleep_until(monotonic() + 0.01);
  port_close();
}

int main(int count, char **arguments) {
  const char *report_path = NULL;
  for (int k = 3; k + 1 < count; k += 2) {
    if (strcmp(arguments[k], "--report") == 0) report_path = arguments[k + 1];
    if (strcmp(arguments[k], "--port") == 0) port = arguments[k + 1];
    if (strcmp(arguments[k], "--ends") == 0) ends = fopen(arguments[k + 1], "w");
  }
  if (count < 3 || count % 2 == 0) {
    fprintf(stderr, "usage: imu_hub_sim SKETCH SCRIPT [--port LINK] [--report FILE] "
                    "[--ends FILE]\n");
    return 2;
  }
  script_load(arguments[2]);
  board_load(arguments[1]);
  signal(SIGINT, on_signal);
  signal(SIGTERM, on_signal);
  if (!port) {
    run_script();
  } else if (port_open(port)) {
    run_port();
  } else {
    fprintf(stderr, "Cannot make a port at `%s`.\n", port);
    return 2;
  }
  if (ends) fclose(ends);
  report(report_path);
  return 0;
}
