/* Quadrature encoders of both wheels, all four edges of each, by interrupt. */
#pragma once

#include <stdint.h>

enum side { LEFT, RIGHT, SIDES };

void encoder_init(void);

/* Counts since the last call, left and right, as wired; call at least every 0.4 s at 80,000 edges a second. */
void encoder_take(int16_t counts[SIDES]);

/* Edges missed since the last call (both channels changed at once: too fast, or noise), bit 0 left, bit 1 right. */
uint8_t encoder_missed(void);
