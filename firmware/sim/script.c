// Lines of a script:
//
//   imu 0 bmi160 0 0x68          number, type, channel (255: none), address
//   motion counter               or formula, or csv PATH with %d for the number of the IMU
//   skew 3000                    by how much the controller's clock is fast [ppm]
//   at 1.5 dead 0                IMU 0 no longer answers; alive 0: plugged in again, unset
//   at 1.5 brownout 0            it lost its power for a moment
//   at 1.5 freeze 0              it repeats its data until it is reset; freeze 0 1: for good
//   at 1.5 refuse 0 7            it ignores every seventh address; 0: none
//   at 1.5 stick 1.0             SDA is held low for so long [s]
//   at 1.5 wedge 2               a device on channel 2 holds SDA until it gets nine clocks
//   at 1.5 mux                   the multiplexer lost its power for a moment
//   at 1.5 lose 1.4              what the controller says for so long gets lost [s]
//   at 1.5 send 03 12 34 00      the host's bytes
//   at 1.5 reset                 of the controller
//   at 5.0 end
#include "script.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "device.h"

#define MOST 256

struct Event {
  double instant;
  char what[16];
  char arguments[512];
};
static struct Event events[MOST];
static int event_count, next_event;

static void complain(const char *line) {
  fprintf(stderr, "This line of the script is not understood: %s\n", line);
  exit(2);
}

static void take_line(const char *line) {
  int imu, channel, address;
  double number;
  char name[16], path[400] = "";
  struct Event *event = &events[event_count];
  if (line[0] == '#' || strspn(line, " \t\r\n") == strlen(line)) return;
  if (sscanf(line, "imu %d %15s %d %i", &imu, name, &channel, &address) == 4) {
    device_add(imu, name, channel, address);
  } else if (sscanf(line, "motion %15s %399s", name, path) >= 1) {
    motion_choose(name, path);
  } else if (sscanf(line, "skew %lf", &number) == 1) {
    board_set_skew(number);
  } else if (event_count < MOST && sscanf(line, "at %lf %15s %511[^\n]", &event->instant,
                                          event->what, event->arguments) >= 2) {
    event_count++;
  } else {
    complain(line);
  }
}

void script_load(const char *path) {
  FILE *file = fopen(path, "r");
  if (!file) {
    fprintf(stderr, "Cannot read the script `%s`.\n", path);
    exit(2);
  }
  char line[600];
  while (fgets(line, sizeof line, file)) take_line(line);
  fclose(file);
  for (int k = 1; k < event_count; k++) {
    if (events[k].instant < events[k - 1].instant) complain("an event before the one above it");
  }
}

double script_next(void) {
  return next_event < event_count ? events[next_event].instant : INFINITY;
}

const char *script_what(void) {
  return events[next_event].what;
}

static void send(const char *text) {
  uint8_t bytes[170];
  int count = 0, used;
  unsigned byte;
  for (; count < 170 && sscanf(text, "%x%n", &byte, &used) == 1; text += used) {
    bytes[count++] = byte;
  }
  uart_hear(bytes, count);
}

bool script_act(void) {
  const struct Event *event = &events[next_event++];
  const char *what = event->what;
  int imu = 0, number = 0;
  sscanf(event->arguments, "%d %d", &imu, &number);
  if (strcmp(what, "end") == 0) return false;
  if (strcmp(what, "reset") == 0) {
    totals.resets++;
    board_reset();
  } else if (strcmp(what, "stick") == 0) {
    lines_stick(atof(event->arguments));
  } else if (strcmp(what, "mux") == 0) {
    bus_reset_mux();
  } else if (strcmp(what, "lose") == 0) {
    lose_spoken(atof(event->arguments));
  } else if (strcmp(what, "wedge") == 0) {
    lines_wedge(imu);
  } else if (strcmp(what, "send") == 0) {
    send(event->arguments);
  } else {
    device_fault(imu, what, number);
  }
  return true;
}
