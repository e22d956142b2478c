#include "encoder.h"

#include "board.h"

#include <avr/interrupt.h>
#include <util/atomic.h>
#include <util/delay.h>

#define CHANNELS 0x0F /* left A, left B, right A, right B */
#define MISSED 2      /* no step: one that can't be */

/* Step by (channels before << 2 | channels now), B in the higher bit; A leads B when the wheel turns forward. In RAM:
 * reading flash costs the interrupt more. */
static const int8_t STEP[16] = {
    0, +1, -1, MISSED,
    -1, 0, MISSED, +1,
    +1, MISSED, 0, -1,
    MISSED, -1, +1, 0,
};

static volatile int16_t count[SIDES];
static volatile uint8_t missed;
static uint8_t before; /* the channels at the last interrupt */

static inline void step(uint8_t side, uint8_t change)
{
    int8_t by = STEP[change];
    if (by == MISSED)
        missed |= (uint8_t)(1 << side);
    else
        count[side] += by;
}

ISR(ENCODER_VECTOR)
{
    uint8_t now = ENCODER_PIN & CHANNELS;
    step(LEFT, (uint8_t)((before & 0x03) << 2 | (now & 0x03)));
    step(RIGHT, (uint8_t)((before & 0x0C) | now >> 2));
    before = now;
}

void encoder_init(void)
{
    ENCODER_PORT |= CHANNELS; /* pull-ups, for encoders with open collectors */
    _delay_us(10);             /* until the pull-ups have charged the wires */
    before = ENCODER_PIN & CHANNELS;
    ENCODER_MASK = CHANNELS;
    PCICR |= ENCODER_ENABLE;
}

void encoder_take(int16_t counts[SIDES])
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        for (uint8_t side = LEFT; side < SIDES; side++) {
            counts[side] = count[side];
            count[side] = 0;
        }
    }
}

uint8_t encoder_missed(void)
{
    uint8_t sides;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        sides = missed;
        missed = 0;
    }
    return sides;
}
