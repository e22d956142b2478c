#include "clock.h"

#include "motor.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#define COUNTS_PER_MS 250 /* 16 MHz / 64: 4 us each */

static volatile uint32_t milliseconds;

/* The permission to drive runs out here, in the interrupt, whatever the main loop is doing. */
ISR(TIMER2_COMPA_vect)
{
    milliseconds++;
    motor_millisecond();
}

void clock_init(void)
{
    OCR2A = COUNTS_PER_MS - 1;
    TCCR2A = _BV(WGM21);
    TCCR2B = _BV(CS22);
    TIMSK2 = _BV(OCIE2A);
}

uint32_t clock_ms(void)
{
    uint32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        now = milliseconds;
    }
    return now;
}

uint32_t clock_us(void)
{
    uint32_t ms;
    uint8_t counts;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        ms = milliseconds;
        counts = TCNT2;
        /* The count has wrapped and its interrupt is still waiting. */
        if ((TIFR2 & _BV(OCF2A)) && counts < COUNTS_PER_MS / 2)
            ms++;
    }
    return ms * 1000 + counts * 4UL;
}
