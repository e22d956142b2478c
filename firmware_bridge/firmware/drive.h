/* Both wheels: set-points in, PWM and counted ticks out. */
#pragma once

#include "encoder.h"

#include <stdbool.h>
#include <stdint.h>

/* Drive at `speed` (ticks/s, forward positive) until the permission runs out. Ignored after a wheel did not do as it was
 * driven, until the host asks for rest (both zero). */
void drive_set(const int32_t speed[SIDES]);

/* Motors off. */
void drive_stop(void);

/* As drive_stop, and a host begins anew: nothing is held against the wheels. */
void drive_forgive(void);

/* One step of CONTROL_HZ. */
void drive_step(void);

/* Ticks since boot. */
const int32_t *drive_ticks(void);

/* The PWM on the outputs now. */
int16_t drive_pwm(enum side side);

/* Bits of TELEMETRY's faults: wheels that did not turn, or turned backwards, or lost edges since the last call. */
uint16_t drive_faults(void);
