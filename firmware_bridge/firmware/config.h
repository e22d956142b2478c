/* What differs from robot to robot, kept in EEPROM. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

/* Bits of `polarity`. */
#define MOTOR_LEFT_REVERSED 0x01
#define MOTOR_RIGHT_REVERSED 0x02
#define ENCODER_LEFT_REVERSED 0x04
#define ENCODER_RIGHT_REVERSED 0x08
#define BUMPERS_OPEN 0x10  /* switches that open when pressed: the pin goes high */
#define CHARGER_LOW 0x20   /* the contact pulls the pin low on the dock */

/* As it stands in CONFIGURE and CONFIG, and in EEPROM; field by field in ../PROTOCOL.md. */
struct config {
    uint32_t ticks_per_1000_rev;
    uint32_t acceleration;     /* ticks/s^2 */
    uint16_t full_speed;       /* ticks/s at full PWM: the feed-forward */
    uint16_t max_speed;        /* ticks/s, limit of set-points */
    uint8_t kp_16;             /* proportional gain in sixteenths */
    uint8_t ki;                /* integral gain, 1/s */
    uint8_t breakaway;         /* PWM that just doesn't turn a wheel */
    uint8_t polarity;
    uint16_t battery_full_scale; /* mV that read as the converter's 5 V */
    uint16_t battery_low;        /* mV */
    uint16_t capabilities;       /* what is wired: bits of HELLO_REPLY */
};
_Static_assert(sizeof(struct config) == 22, "the layout of CONFIGURE");

/* Where the configuration in force came from. */
enum config_source {
    CONFIG_DEFAULT, /* nothing was ever stored */
    CONFIG_STORED,
    CONFIG_DAMAGED, /* what was stored fails its checksum: defaults, and a fault in telemetry */
};

extern struct config config; /* in force */

/* Reads the EEPROM, or takes the defaults. */
void config_load(void);

enum config_source config_source(void);

/* Whether `wanted` can be driven with: no zero that is divided by, no set-point beyond what the wheels reach. */
bool config_acceptable(const struct config *wanted);

/* Begins to store `wanted`; the old one stays in force. Only while no other is being stored. */
void config_store(const struct config *wanted);

bool config_storing(void);

/* Goes on storing, a byte at most: one takes 3.4 ms, and the main loop must not wait. True when it has just finished and
 * `config` is the new one. */
bool config_work(void);
