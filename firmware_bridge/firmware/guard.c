#include "guard.h"

#include "wheel.h"

#define HARD 102                    /* 40 % PWM: enough to move any wheel that can */
#define PATIENCE (CONTROL_HZ * 3 / 10) /* steps: 0.3 s, three times what a motor takes to turn round */
#define MOVES 3                     /* ticks: more than the play of a gear box */

static int8_t way(int16_t pwm)
{
    return pwm >= HARD ? 1 : pwm <= -HARD ? -1 : 0;
}

static enum verdict judge(const struct guard *guard)
{
    int16_t along = guard->way > 0 ? guard->moved : -guard->moved;
    if (along < -MOVES)
        return GUARD_BACKWARDS;
    return along < MOVES ? GUARD_STUCK : GUARD_FINE;
}

enum verdict guard_step(struct guard *guard, int16_t pwm, int16_t counted)
{
    if (guard->way == 0 || guard->way != way(pwm)) {
        *guard = (struct guard){way(pwm), 0, 0};
        return GUARD_FINE;
    }
    guard->moved += counted;
    if (++guard->steps < PATIENCE)
        return GUARD_FINE;
    enum verdict verdict = judge(guard);
    *guard = (struct guard){way(pwm), 0, 0};
    return verdict;
}
