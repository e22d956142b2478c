#include "robot.h"

#include <math.h>

/* Data addresses, the same on the ATmega328P and the ATmega2560. */
#define TCCR1A 0x80
#define ICR1 0x86
#define OCR1 0x88 /* A; B is two further */
#define WAVE_CLEARED_ON_MATCH 2

static double pulse_width(const struct robot *robot, int side)
{
    const uint8_t *data = robot->avr->data;
    struct pin pin = robot->layout.pwm[side];
    if (!is_output(robot, pin))
        return 0.0;
    if ((data[TCCR1A] >> (side == LEFT ? 6 : 4) & 3) != WAVE_CLEARED_ON_MATCH)
        return driven_high(robot, pin);
    const uint8_t *compare = &data[OCR1 + 2 * side];
    double counts = compare[0] + 256.0 * compare[1] + 1.0;
    return fmin(counts / (data[ICR1] + 256.0 * data[ICR1 + 1] + 1.0), 1.0);
}

double duty(const struct robot *robot, int side)
{
    int way = driven_high(robot, robot->layout.forward[side]) - driven_high(robot, robot->layout.backward[side]);
    return way == 0 || !driven_high(robot, robot->layout.standby) ? 0.0 : way * pulse_width(robot, side);
}

/* A wheel that would roll past its goal within the step gets there just at its end. */
static void brake(struct wheel *wheel)
{
    double way = wheel->goal - wheel->angle; /* NAN compares false */
    if (fabs(way) < fabs(wheel->speed) * STEP / HZ || way * wheel->speed < 0.0)
        wheel->speed = way / STEP * HZ;
}

static void drive(struct wheel *wheel)
{
    double given = wheel->robot->duty[wheel->side];
    if (wheel->lag <= 0.0) {
        brake(wheel);
        return;
    }
    double turning = copysign(fmax(fabs(given) - wheel->friction, 0.0), given) * wheel->full_speed;
    wheel->speed += (turning - wheel->speed) * -expm1(-STEP / HZ / wheel->lag);
}

/* ---- Encoders: A leads B, so that BA runs 00, 01, 11, 10 as the wheel turns forward */

void show_encoder(struct wheel *wheel)
{
    int phase = (int)(wheel->edge & 3);
    struct layout *layout = &wheel->robot->layout;
    show(wheel->robot, layout->channel_a[wheel->side], wheel->unplugged || phase == 1 || phase == 2);
    show(wheel->robot, layout->channel_b[wheel->side], wheel->unplugged || phase >= 2);
}

/* When the wheel passes its next edge at the speed of now; 0 where it won't within the step. */
static uint64_t next_edge(const struct wheel *wheel)
{
    if (wheel->speed == 0.0)
        return 0;
    double way = wheel->speed > 0.0 ? wheel->edge + 1.0 - wheel->angle : wheel->angle - wheel->edge;
    double cycles = fmax(way / fabs(wheel->speed) * HZ, 0.0);
    return cycles < STEP ? wheel->since + (uint64_t)cycles : 0;
}

static avr_cycle_count_t pass_edge(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    struct wheel *wheel = parameter;
    (void)avr;
    wheel->edge += wheel->speed > 0.0 ? 1 : -1;
    show_encoder(wheel);
    uint64_t next = next_edge(wheel);
    return next == 0 ? 0 : next > when ? next : when + 1;
}

void turn(struct wheel *wheel, uint64_t now)
{
    avr_t *avr = wheel->robot->avr;
    /* Signed: a step that is a few cycles late is told the time it should have come at. */
    wheel->angle += wheel->speed * (double)(int64_t)(now - wheel->since) / HZ;
    wheel->since = now;
    drive(wheel);
    uint64_t next = next_edge(wheel);
    avr_cycle_timer_cancel(avr, pass_edge, wheel);
    if (next != 0)
        avr_cycle_timer_register(avr, next > avr->cycle ? next - avr->cycle : 0, pass_edge, wheel);
}

void robot_motor(struct robot *robot, int side, double full_speed, double lag, double friction)
{
    struct wheel *wheel = &robot->wheels[side];
    wheel->full_speed = full_speed;
    wheel->lag = lag;
    wheel->friction = friction;
}

/* From now on the wheel turns at `speed`, whatever its motor does. */
void robot_spin(struct robot *robot, int side, double speed)
{
    struct wheel *wheel = &robot->wheels[side];
    turn(wheel, robot->avr->cycle);
    wheel->lag = 0.0;
    wheel->goal = NAN;
    wheel->speed = speed;
    turn(wheel, robot->avr->cycle);
}

/* The wheel turns evenly until it has made `ticks` in `seconds`, and stays there. */
void robot_roll(struct robot *robot, int side, int64_t ticks, double seconds)
{
    struct wheel *wheel = &robot->wheels[side];
    robot_spin(robot, side, 0.0);
    wheel->goal = ticks + 0.5; /* well past the edge of that tick */
    wheel->speed = (wheel->goal - wheel->angle) / seconds;
    turn(wheel, robot->avr->cycle);
}

void robot_unplug(struct robot *robot, int side, int unplugged)
{
    robot->wheels[side].unplugged = unplugged;
    show_encoder(&robot->wheels[side]);
}

double robot_duty(const struct robot *robot, int side) { return robot->duty[side]; }
int64_t robot_edge(const struct robot *robot, int side) { return robot->wheels[side].edge; }
double robot_speed(const struct robot *robot, int side) { return robot->wheels[side].speed; }
