#include "wheel.h"

/* PI with feed-forward, in ticks/s until the last line:
 *
 *     effort = wanted + kp * (wanted - measured) + ki * (ticks behind)
 *     pwm    = effort / full_speed * 255
 *
 * The integral is kept in counted ticks, not in a measured speed: the wheel is where the sum of its set-points says,
 * to the tick, however coarse the encoder. Gains have no unit of voltage or wheel size, so that only `full_speed` has
 * to be known of a motor. */

#define FRACTION 256L                           /* of `wanted` */
#define BEHIND_PER_TICK (FRACTION * CONTROL_HZ) /* one step at `wanted` adds exactly `wanted` */
#define BEHIND_SHIFT 9                          /* to hundredths of a tick: 256 * 200 / 512 = 100 */
#define BEHIND_MOST 4000000L                    /* hundredths of a tick that fit 32 bits after the shift */
#define PWM_MOST 255
#define ONE_COUNT (CONTROL_HZ / WHEEL_WINDOW) /* ticks/s that one count in the window looks like */

static int32_t clamp(int32_t value, int32_t most)
{
    return value > most ? most : value < -most ? -most : value;
}

static int32_t remember(struct wheel *wheel, int16_t counted)
{
    wheel->counts[wheel->next] = counted;
    wheel->next = (uint8_t)((wheel->next + 1) % WHEEL_WINDOW);
    int32_t sum = 0;
    for (uint8_t i = 0; i < WHEEL_WINDOW; i++)
        sum += wheel->counts[i];
    return sum * (CONTROL_HZ / WHEEL_WINDOW);
}

void wheel_coast(struct wheel *wheel, int16_t counted)
{
    wheel->wanted = remember(wheel, counted) * FRACTION;
    wheel->behind = 0;
    wheel->pwm = 0;
}

static void approach(struct wheel *wheel, int32_t target)
{
    int32_t most = (int32_t)(config.acceleration * (FRACTION / 8) / (CONTROL_HZ / 8));
    wheel->wanted += clamp(clamp(target, config.max_speed) * FRACTION - wheel->wanted, most > 0 ? most : 1);
}

/* Ticks behind, times ki. What the motor can't do anyway is not saved up: it would be made good with an overshoot. */
static int32_t integral(struct wheel *wheel, int16_t counted)
{
    int32_t most = (int32_t)config.full_speed * 100 / (config.ki > 0 ? config.ki : 1);
    int32_t change = wheel->wanted - (int32_t)counted * BEHIND_PER_TICK;
    bool saturated = wheel->pwm == PWM_MOST || wheel->pwm == -PWM_MOST;
    if (!saturated || (change > 0) != (wheel->pwm > 0))
        wheel->behind = clamp(wheel->behind + change, clamp(most, BEHIND_MOST) << BEHIND_SHIFT);
    return (wheel->behind >> BEHIND_SHIFT) * config.ki / 100;
}

/* The part of PWM that turns nothing is added on the side the wheel is meant to turn to. */
static int16_t to_pwm(int32_t effort, int32_t wanted)
{
    int32_t span = PWM_MOST - config.breakaway;
    int32_t pwm = clamp(effort, config.full_speed) * span / config.full_speed;
    pwm += wanted > 0 ? config.breakaway : wanted < 0 ? -config.breakaway : 0;
    return (int16_t)clamp(pwm, PWM_MOST);
}

int16_t wheel_step(struct wheel *wheel, int32_t target, int16_t counted)
{
    int32_t measured = remember(wheel, counted);
    approach(wheel, target);
    if (wheel->wanted == 0 && measured >= -ONE_COUNT && measured <= ONE_COUNT) {
        wheel->behind = 0; /* at rest: no humming round the last edge */
        wheel->pwm = 0;
        return 0;
    }
    int32_t wanted = wheel->wanted / FRACTION;
    int32_t effort = wanted + (wanted - measured) * config.kp_16 / 16 + integral(wheel, counted);
    wheel->pwm = to_pwm(effort, wanted);
    return wheel->pwm;
}
