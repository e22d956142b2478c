#include "sense.h"

#include "board.h"
#include "config.h"
#include "messages.h"

#define SMOOTHING 16 /* control steps: 80 ms */

static uint8_t pressed; /* bumpers, since the last report: a knock is shorter than a period of telemetry */
static uint16_t level;  /* the converter's reading, times SMOOTHING */

static void start_conversion(void)
{
    ADCSRA |= _BV(ADSC);
}

void sense_init(void)
{
    BUMPER_PORT |= BUMPER_LEFT | BUMPER_RIGHT; /* pull-ups */
    ADMUX = _BV(REFS0) | BATTERY_CHANNEL;
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    start_conversion();
    while (ADCSRA & _BV(ADSC))
        ; /* 0.2 ms; the smoothing begins at a true value */
    level = (uint16_t)(ADC * SMOOTHING);
    start_conversion();
}

static uint8_t bumpers(void)
{
    uint8_t high = BUMPER_PIN;
    uint8_t closed = config.polarity & BUMPERS_OPEN ? high : (uint8_t)~high;
    return (closed & BUMPER_LEFT ? STATUS_BUMPER_LEFT : 0) | (closed & BUMPER_RIGHT ? STATUS_BUMPER_RIGHT : 0);
}

void sense_step(void)
{
    if (config.capabilities & CAPABILITY_BUMPERS)
        pressed |= bumpers();
    if (ADCSRA & _BV(ADSC))
        return;
    level = (uint16_t)(level - level / SMOOTHING + ADC);
    start_conversion();
}

uint8_t sense_status(void)
{
    uint8_t status = pressed;
    pressed = 0;
    bool high = CHARGER_PIN & CHARGER;
    if ((config.capabilities & CAPABILITY_CHARGING) && high != ((config.polarity & CHARGER_LOW) != 0))
        status |= STATUS_CHARGING;
    return status;
}

uint16_t sense_battery(void)
{
    if (!(config.capabilities & CAPABILITY_BATTERY))
        return 0;
    return (uint16_t)((uint32_t)level * config.battery_full_scale / (1024UL * SMOOTHING));
}
