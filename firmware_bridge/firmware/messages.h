/* Messages of the native protocol as they stand in a payload; field by field in ../PROTOCOL.md. An AVR is
 * little-endian and has no padding, so a struct is its own encoding. */
#pragma once

#include "config.h"

#include <stdint.h>

#define PROTOCOL_VERSION 2

enum {
    HELLO = 0x01,
    SETPOINT = 0x02,
    STOP = 0x03,
    RELEASE = 0x04,
    GET_CONFIG = 0x05,
    CONFIGURE = 0x06,
    HELLO_REPLY = 0x81,
    ACK = 0x82,
    TELEMETRY = 0x83,
    CONFIG = 0x85,
};

enum {
    CAPABILITY_BUMPERS = 0x01,
    CAPABILITY_CHARGING = 0x08,
    CAPABILITY_BATTERY = 0x10,
    CAPABILITY_CONFIG = 0x40,
};

enum {
    STATUS_BUMPER_LEFT = 0x01,
    STATUS_BUMPER_RIGHT = 0x02,
    STATUS_CHARGING = 0x10,
    STATUS_EMERGENCY_STOP = 0x20,
    STATUS_MOVING_ALLOWED = 0x40,
};

enum {
    FAULT_MOTOR = 0x01,   /* shifted by the side */
    FAULT_ENCODER = 0x04, /* shifted by the side */
    FAULT_BATTERY_LOW = 0x10,
    FAULT_CONFIGURATION = 0x40,
};

struct hello {
    uint8_t version;
};

struct setpoint {
    uint32_t boot_nonce;
    int32_t speed[2]; /* left, right; ticks/s */
    uint32_t mcu_us;  /* when it was sent, by our clock */
};

struct release {
    uint32_t boot_nonce;
};

struct configure {
    uint32_t boot_nonce;
    struct config config;
};

struct hello_reply {
    uint8_t version;
    uint16_t watchdog_ms;
    uint32_t ticks_per_1000_rev;
    uint32_t boot_nonce;
    uint32_t firmware;
    char board[16];
    uint16_t capabilities;
};

struct ack {
    uint8_t kind;
    uint8_t seq;
};

struct telemetry {
    uint32_t boot_nonce;
    uint32_t mcu_us;
    int32_t ticks[2];
    int16_t pwm[2];
    uint8_t status;
    uint16_t faults;
    uint16_t battery_mv;
    uint8_t setpoint_seq;
    uint16_t crc_errors;
    uint16_t overruns;
};

struct config_report {
    uint32_t boot_nonce;
    struct config config;
    uint8_t source;
};

_Static_assert(sizeof(struct setpoint) == 16 && sizeof(struct hello_reply) == 33, "as in PROTOCOL.md");
_Static_assert(sizeof(struct telemetry) == 30 && sizeof(struct configure) == 26, "as in PROTOCOL.md");
