#include "drive.h"

#include "guard.h"
#include "messages.h"
#include "motor.h"
#include "wheel.h"

static const uint8_t MOTOR_REVERSED[SIDES] = {MOTOR_LEFT_REVERSED, MOTOR_RIGHT_REVERSED};
static const uint8_t ENCODER_REVERSED[SIDES] = {ENCODER_LEFT_REVERSED, ENCODER_RIGHT_REVERSED};

static struct wheel wheels[SIDES];
static struct guard guards[SIDES];
static int32_t target[SIDES];
static int32_t ticks[SIDES];
static uint8_t tripped; /* faults that hold the wheels */

void drive_set(const int32_t speed[SIDES])
{
    if (speed[LEFT] == 0 && speed[RIGHT] == 0)
        tripped = 0;
    if (tripped)
        return;
    target[LEFT] = speed[LEFT];
    target[RIGHT] = speed[RIGHT];
    motor_permit();
}

void drive_stop(void)
{
    motor_off();
}

void drive_forgive(void)
{
    drive_stop();
    tripped = 0;
}

static void trip(enum side side, enum verdict verdict)
{
    if (verdict == GUARD_FINE)
        return;
    tripped |= (uint8_t)((verdict == GUARD_STUCK ? FAULT_MOTOR : FAULT_ENCODER) << side);
    drive_stop();
}

static int16_t step(enum side side, int16_t counted)
{
    struct wheel *wheel = &wheels[side];
    ticks[side] += counted;
    trip(side, guard_step(&guards[side], wheel->pwm, counted));
    if (motor_permitted())
        return wheel_step(wheel, target[side], counted);
    wheel_coast(wheel, counted);
    return 0;
}

void drive_step(void)
{
    int16_t counted[SIDES], pwm[SIDES];
    encoder_take(counted);
    for (uint8_t side = LEFT; side < SIDES; side++) {
        if (config.polarity & ENCODER_REVERSED[side])
            counted[side] = -counted[side];
        pwm[side] = step(side, counted[side]);
        if (config.polarity & MOTOR_REVERSED[side])
            pwm[side] = -pwm[side];
    }
    motor_drive(pwm);
}

const int32_t *drive_ticks(void)
{
    return ticks;
}

int16_t drive_pwm(enum side side)
{
    return motor_permitted() ? wheels[side].pwm : 0;
}

uint16_t drive_faults(void)
{
    return tripped | (uint16_t)(encoder_missed() * FAULT_ENCODER);
}
