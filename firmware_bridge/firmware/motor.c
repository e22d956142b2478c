#include "motor.h"

#include "board.h"

#include <util/atomic.h>

/* Fast PWM at 15.7 kHz, hardly audible and slow enough for an L298; four counts a step of PWM, so that 255 is "always
 * on". */
#define COUNTS_PER_STEP 4
#define TOP (COUNTS_PER_STEP * MOTOR_MAX_PWM - 1)

static volatile uint8_t permission; /* milliseconds left; 0: off */

static void outputs_off(void)
{
    STANDBY_PORT &= (uint8_t)~STANDBY;
    TCCR1A &= (uint8_t)~(_BV(COM1A1) | _BV(COM1B1)); /* fast PWM can't make 0 %: let go of the pins, which are low */
    LEFT_PORT &= (uint8_t)~(LEFT_FORWARD | LEFT_BACKWARD);
    RIGHT_PORT &= (uint8_t)~(RIGHT_FORWARD | RIGHT_BACKWARD);
    LIGHT_PORT &= (uint8_t)~LIGHT;
}

static void set_direction(volatile uint8_t *port, uint8_t forward, uint8_t backward, int16_t pwm)
{
    uint8_t pins = *port & (uint8_t)~(forward | backward);
    *port = pins | (pwm > 0 ? forward : pwm < 0 ? backward : 0);
}

static uint16_t width(int16_t pwm)
{
    uint16_t size = (uint16_t)(pwm < 0 ? -pwm : pwm);
    return COUNTS_PER_STEP * (size > MOTOR_MAX_PWM ? MOTOR_MAX_PWM : size);
}

static void outputs_drive(const int16_t pwm[SIDES])
{
    set_direction(&LEFT_PORT, LEFT_FORWARD, LEFT_BACKWARD, pwm[LEFT]);
    set_direction(&RIGHT_PORT, RIGHT_FORWARD, RIGHT_BACKWARD, pwm[RIGHT]);
    OCR1A = width(pwm[LEFT]);
    OCR1B = width(pwm[RIGHT]);
    uint8_t waves = (pwm[LEFT] != 0 ? _BV(COM1A1) : 0) | (pwm[RIGHT] != 0 ? _BV(COM1B1) : 0);
    TCCR1A = (TCCR1A & (uint8_t)~(_BV(COM1A1) | _BV(COM1B1))) | waves;
    STANDBY_PORT |= STANDBY;
    LIGHT_PORT |= LIGHT;
}

void motor_init(void)
{
    outputs_off();
    STANDBY_DDR |= STANDBY;
    PWM_DDR |= PWM_LEFT | PWM_RIGHT;
    LEFT_DDR |= LEFT_FORWARD | LEFT_BACKWARD;
    RIGHT_DDR |= RIGHT_FORWARD | RIGHT_BACKWARD;
    LIGHT_DDR |= LIGHT;
    ICR1 = TOP;
    TCCR1A = _BV(WGM11);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
}

void motor_permit(void)
{
    permission = MOTOR_PERMISSION_MS;
}

void motor_off(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        permission = 0;
        outputs_off();
    }
}

bool motor_permitted(void)
{
    return permission > 0;
}

void motor_millisecond(void)
{
    if (permission > 0 && --permission == 0)
        outputs_off();
}

void motor_drive(const int16_t pwm[SIDES])
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (permission > 0)
            outputs_drive(pwm);
    }
}
