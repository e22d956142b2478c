#include "config.h"

#include "eeprom_map.h"
#include "framing.h"

#include <avr/eeprom.h>
#include <avr/pgmspace.h>
#include <string.h>

#define LAYOUT 1 /* of the record; another one is as good as damaged */
#define BLANK 0xFF

/* Bits of `capabilities`. */
#define BUMPERS 0x01
#define CHARGING 0x08
#define BATTERY 0x10
#define CONFIGURABLE 0x40
#define KNOWN (BUMPERS | CHARGING | BATTERY)

struct record {
    uint8_t layout;
    struct config config;
    uint16_t crc;
};

/* 70 mm wheels with 1440 counts a turn, motors of 160 turns a minute, three lithium cells over 33 k and 10 k. */
static const struct config DEFAULTS PROGMEM = {
    .ticks_per_1000_rev = 1440000,
    .acceleration = 16000,
    .full_speed = 4000,
    .max_speed = 3600,
    .kp_16 = 24,
    .ki = 10,
    .breakaway = 0,
    .polarity = 0,
    .battery_full_scale = 21500,
    .battery_low = 9900,
    .capabilities = KNOWN | CONFIGURABLE,
};

#define STORED ((struct record *)EEPROM_CONFIG)

struct config config;
static enum config_source source;
static struct record pending;
static uint8_t written = sizeof(struct record); /* bytes of `pending` that are in EEPROM */

static bool intact(const struct record *record)
{
    return record->layout == LAYOUT && record->crc == crc16(record, sizeof *record - sizeof record->crc) &&
           config_acceptable(&record->config);
}

static bool blank(const struct record *record)
{
    const uint8_t *byte = (const uint8_t *)record;
    for (uint8_t i = 0; i < sizeof *record; i++)
        if (byte[i] != BLANK)
            return false;
    return true;
}

void config_load(void)
{
    struct record record;
    eeprom_read_block(&record, STORED, sizeof record);
    if (intact(&record)) {
        config = record.config;
        source = CONFIG_STORED;
        return;
    }
    memcpy_P(&config, &DEFAULTS, sizeof config);
    source = blank(&record) ? CONFIG_DEFAULT : CONFIG_DAMAGED;
}

enum config_source config_source(void)
{
    return source;
}

bool config_acceptable(const struct config *wanted)
{
    return wanted->ticks_per_1000_rev > 0 && wanted->acceleration > 0 && wanted->acceleration <= 1000000 &&
           wanted->full_speed > 0 && wanted->max_speed > 0 && wanted->max_speed <= wanted->full_speed &&
           wanted->breakaway < 128 && (wanted->capabilities & ~KNOWN) == CONFIGURABLE;
}

void config_store(const struct config *wanted)
{
    pending.layout = LAYOUT;
    pending.config = *wanted;
    pending.crc = crc16(&pending, sizeof pending - sizeof pending.crc);
    written = 0;
}

bool config_storing(void)
{
    return written < sizeof pending;
}

bool config_work(void)
{
    if (!config_storing() || !eeprom_is_ready())
        return false;
    eeprom_update_byte((uint8_t *)STORED + written, ((const uint8_t *)&pending)[written]);
    if (++written < sizeof pending)
        return false;
    config = pending.config;
    source = CONFIG_STORED;
    return true;
}
