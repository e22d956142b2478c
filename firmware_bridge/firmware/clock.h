/* Time since boot, from timer 2. */
#pragma once

#include <stdint.h>

void clock_init(void);

/* Milliseconds; wraps after 49 days. */
uint32_t clock_ms(void);

/* Microseconds in steps of 4; wraps after 71.6 minutes. */
uint32_t clock_us(void);
