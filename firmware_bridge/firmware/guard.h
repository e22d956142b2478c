/* Watches that a driven wheel turns, and the way it is driven. Touches no hardware.
 *
 * An encoder whose wire is off makes the loop push ever harder, one with its channels swapped makes it run away: both
 * are wiring mistakes that everybody makes once. A wheel that is blocked looks like the first and burns its motor. */
#pragma once

#include <stdint.h>

enum verdict { GUARD_FINE, GUARD_STUCK, GUARD_BACKWARDS };

struct guard {
    int8_t way;    /* the wheel is driven: 1 forward, -1 backward, 0 not hard enough to judge */
    uint8_t steps; /* since then */
    int16_t moved; /* ticks counted since then */
};

/* One control step: what was driven and what was counted. */
enum verdict guard_step(struct guard *guard, int16_t pwm, int16_t counted);
