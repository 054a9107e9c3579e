// Reads one to eight IMUs behind a TCA9548A and sends what they say; docs/firmware.md.
// Nothing here waits: a scan is read when it is due, and all else comes in between.
#include <Wire.h>

#include "bus.h"
#include "clock.h"
#include "config.h"
#include "imu.h"
#include "link.h"
#include "uart.h"

const uint32_t PERIOD_US = 1000000UL / SCAN_RATE_HZ;
// Most of what comes in between takes less; what takes more delays the next scan a little.
const uint32_t SPARE_US = 600;

// The first scan waits for all places; where some stay empty, for what starts most slowly.
const uint32_t BEGIN_BY_US = 900000;

static uint32_t scan_at;
static bool begun;   // the first scan is due at `scan_at`
static bool tended;  // since the last scan

void setup() {
  clock_begin();
  link_begin();
  bus_begin();
  imus_begin();
}

static void tend() {
  if (!link_tend()) {
    bus_tend();
    imus_tend(!tended);
  }
  tended = true;
}

// Look for IMUs, say who is there, and start them.
static void start() {
  tended = false;
  tend();
  begun = imus_ready() || clock_reached(BEGIN_BY_US);
  begun = begun && link_has_greeted();
  scan_at = clock_us() + PERIOD_US;
}

// Scans whose time has passed while the bus was stuck are left out, and counted.
static void skip_late_scans() {
  while (clock_reached(scan_at + PERIOD_US)) {
    link_skip_scan();
    scan_at += PERIOD_US;
  }
}

void loop() {
  uart_tend();
  if (link_has_greeted()) link_answer();
  if (!begun) return start();
  if (!tended) {
    tend();  // once a scan even where there is no time
  } else if (clock_reached(scan_at)) {
    skip_late_scans();
    link_scan();
    scan_at += PERIOD_US;
    tended = false;
  } else if (!clock_reached(scan_at - SPARE_US)) {
    tend();
  }
}
