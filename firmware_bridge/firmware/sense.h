/* Bumpers, charging contact and battery voltage. */
#pragma once

#include <stdint.h>

void sense_init(void);

/* Samples everything; call at every control step. */
void sense_step(void);

/* Bits of TELEMETRY's status: bumpers that were pressed at any time since the last call, charging as it is. */
uint8_t sense_status(void);

/* Millivolts, smoothed over a few tenths of a second; 0 where the configuration has no battery wired. */
uint16_t sense_battery(void);
