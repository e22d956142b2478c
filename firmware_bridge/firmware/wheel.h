/* Closed-loop speed of one wheel. Touches no hardware. */
#pragma once

#include "config.h"

#include <stdint.h>

#define CONTROL_HZ 200
#define WHEEL_WINDOW 4 /* steps over which speed is measured: 20 ms, so that one count is 50 ticks/s, not 200 */

struct wheel {
    int32_t wanted;               /* the set-point behind the acceleration limit, ticks/s * 256 */
    int32_t behind;               /* ticks that should have come and did not, in BEHIND_PER_TICK */
    int16_t counts[WHEEL_WINDOW]; /* of the last steps, round and round */
    uint8_t next;
    int16_t pwm;                  /* the last output */
};

/* One step without drive: the loop takes over from whatever speed the wheel rolls at. */
void wheel_coast(struct wheel *wheel, int16_t counted);

/* One step of CONTROL_HZ: the PWM (-255 to 255) that turns the wheel at `target` ticks/s, `counted` ticks having come
 * since the last step. */
int16_t wheel_step(struct wheel *wheel, int32_t target, int16_t counted);
