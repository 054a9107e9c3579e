// A serial port that is none: a pseudo-terminal behind a link.  What nobody reads in time is lost,
// as the Mega's USB chip loses it.
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include "sim.h"

static int master = -1;
static const char *link_path;

bool port_open(const char *path) {
  master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (master < 0 || grantpt(master) != 0 || unlockpt(master) != 0) return false;
  // Raw, and closed again: a hang-up then tells that nobody has it open.
  const int far = open(ptsname(master), O_RDWR | O_NOCTTY);
  struct termios modes;
  if (far < 0 || tcgetattr(far, &modes) != 0) return false;
  cfmakeraw(&modes);
  tcsetattr(far, TCSANOW, &modes);
  close(far);
  link_path = path;
  unlink(path);
  return symlink(ptsname(master), path) == 0;
}

bool port_is_read(void) {
  struct pollfd state = {.fd = master, .events = 0};
  poll(&state, 1, 0);
  return !(state.revents & POLLHUP);
}

void port_write(const uint8_t *bytes, int count) {
  const int written = count > 0 ? write(master, bytes, count) : 0;
  totals.dropped_bytes += count - (written > 0 ? written : 0);
}

int port_read(uint8_t *bytes, int count) {
  const int got = read(master, bytes, count);
  return got > 0 ? got : 0;
}

void port_close(void) {
  unlink(link_path);
  close(master);
}
