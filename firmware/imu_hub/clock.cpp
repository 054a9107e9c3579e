// Timer 1 counts half microseconds (16 MHz / 8) in 16 bits; its overflows are counted here.
#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>

static volatile uint32_t overflows;

ISR(TIMER1_OVF_vect) {
  overflows++;
}

void clock_begin() {
  TCCR1A = 0;  // the Arduino core had set up PWM
  TCCR1B = 0;
  TCNT1 = 0;
  TIFR1 = _BV(TOV1);
  TIMSK1 = _BV(TOIE1);
  TCCR1B = _BV(CS11);
}

uint32_t clock_us() {
  const uint8_t status = SREG;
  cli();
  const uint16_t ticks = TCNT1;
  uint32_t high = overflows;
  // An overflow whose interrupt still waits; a large count was read before it.
  if ((TIFR1 & _BV(TOV1)) && ticks < 0x8000) high++;
  SREG = status;
  return (high << 15) | (ticks >> 1);
}
