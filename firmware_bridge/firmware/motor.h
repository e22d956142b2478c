/* The motor outputs, and the only way to drive them: with a permission that runs out.
 *
 * Nothing else in the firmware writes these pins. The permission is counted down in the timer interrupt, so that a main
 * loop that hangs stops the wheels as surely as a host that is silent; an interrupt that hangs as well, or a clock that
 * stands still, ends in the hardware watchdog's reset, which leaves the pins to their pull-downs. */
#pragma once

#include "encoder.h"

#include <stdbool.h>
#include <stdint.h>

#define MOTOR_PERMISSION_MS 250
#define MOTOR_MAX_PWM 255

/* Outputs low, standby. */
void motor_init(void);

/* May drive for MOTOR_PERMISSION_MS from now. */
void motor_permit(void);

/* Off at once, and no permission. */
void motor_off(void);

bool motor_permitted(void);

/* One millisecond has passed; called by the clock's interrupt alone. */
void motor_millisecond(void);

/* PWM of both wheels, -255 to 255, forward positive as wired; without permission they stay off. */
void motor_drive(const int16_t pwm[SIDES]);
