#include "session.h"

#include "board.h"
#include "clock.h"
#include "config.h"
#include "drive.h"
#include "messages.h"
#include "motor.h"
#include "sense.h"
#include "uart.h"

#include <stdbool.h>
#include <string.h>

/* By how much a set-point may be old, and by how much its host's reckoning of our clock may be ahead of it; us. */
#define LATE 250000
#define EARLY 20000

static uint32_t nonce;
static bool greeted;
static bool latched;       /* emergency stop */
static bool applied;       /* a set-point has been, since the last HELLO */
static uint8_t applied_seq; /* its number */
static uint8_t own_seq;
static uint8_t configure_seq;

void session_init(uint32_t boot_nonce)
{
    nonce = boot_nonce;
}

static void say(uint8_t kind, const void *payload, uint8_t length)
{
    uint8_t bytes[FRAME_MAX_ENCODED + 1];
    struct frame frame = {kind, ++own_seq, length, payload};
    /* A host that asks faster than the line can answer loses answers: it repeats what needs one. */
    (void)uart_write(bytes, frame_encode(&frame, bytes));
}

static void acknowledge(uint8_t kind, uint8_t seq)
{
    struct ack ack = {kind, seq};
    say(ACK, &ack, sizeof ack);
}

/* Rule 2. */
static void on_hello(const struct hello *hello)
{
    struct hello_reply reply = {
        .version = PROTOCOL_VERSION,
        .watchdog_ms = MOTOR_PERMISSION_MS,
        .ticks_per_1000_rev = config.ticks_per_1000_rev,
        .boot_nonce = nonce,
        .firmware = FIRMWARE_HASH,
        .board = BOARD_NAME,
        .capabilities = config.capabilities,
    };
    if (hello->version == PROTOCOL_VERSION) {
        drive_forgive();
        applied = false;
        greeted = true;
    }
    say(HELLO_REPLY, &reply, sizeof reply);
}

/* Rule 3: half the circle is newer; once the watchdog has stopped the wheels, all but a repetition is. */
static bool newer(uint8_t seq)
{
    uint8_t ahead = seq - applied_seq;
    if (!applied)
        return true;
    return ahead != 0 && (ahead < 128 || !motor_permitted());
}

static bool untimely(uint32_t mcu_us)
{
    return clock_us() - mcu_us + EARLY > LATE + EARLY;
}

static void on_setpoint(const struct setpoint *setpoint, uint8_t seq)
{
    bool rest = setpoint->speed[LEFT] == 0 && setpoint->speed[RIGHT] == 0;
    if (!greeted || latched || config_storing())
        return;
    if (setpoint->boot_nonce != nonce || !newer(seq))
        return;
    if (!rest && untimely(setpoint->mcu_us))
        return;
    applied = true;
    applied_seq = seq;
    drive_set(setpoint->speed);
}

/* Rule 5. */
static void on_stop(uint8_t seq)
{
    latched = true;
    drive_stop();
    acknowledge(STOP, seq);
}

static void on_release(const struct release *release, uint8_t seq)
{
    if (release->boot_nonce != nonce)
        return;
    latched = false;
    acknowledge(RELEASE, seq);
}

static void on_get_config(void)
{
    struct config_report report = {nonce, config, config_source()};
    say(CONFIG, &report, sizeof report);
}

/* Rule 6. */
static void on_configure(const struct configure *configure, uint8_t seq)
{
    if (configure->boot_nonce != nonce || motor_permitted() || config_storing())
        return;
    if (!config_acceptable(&configure->config))
        return;
    configure_seq = seq;
    config_store(&configure->config);
}

void session_configured(void)
{
    acknowledge(CONFIGURE, configure_seq);
}

static uint8_t payload_length(uint8_t kind)
{
    switch (kind) {
    case HELLO:
        return sizeof(struct hello);
    case SETPOINT:
        return sizeof(struct setpoint);
    case RELEASE:
        return sizeof(struct release);
    case CONFIGURE:
        return sizeof(struct configure);
    default:
        return 0;
    }
}

void session_obey(const struct frame *frame)
{
    const void *payload = frame->payload;
    if (frame->length != payload_length(frame->kind))
        return;
    switch (frame->kind) {
    case HELLO:
        on_hello(payload);
        break;
    case SETPOINT:
        on_setpoint(payload, frame->seq);
        break;
    case STOP:
        on_stop(frame->seq);
        break;
    case RELEASE:
        on_release(payload, frame->seq);
        break;
    case GET_CONFIG:
        on_get_config();
        break;
    case CONFIGURE:
        on_configure(payload, frame->seq);
        break;
    }
}

static uint8_t status(void)
{
    return sense_status() | (latched ? STATUS_EMERGENCY_STOP : 0) | (motor_permitted() ? STATUS_MOVING_ALLOWED : 0);
}

static uint16_t faults(uint16_t battery)
{
    bool low = (config.capabilities & CAPABILITY_BATTERY) && battery < config.battery_low;
    return drive_faults() | (low ? FAULT_BATTERY_LOW : 0) |
           (config_source() == CONFIG_DAMAGED ? FAULT_CONFIGURATION : 0);
}

void session_report(uint16_t broken, uint16_t overruns)
{
    uint16_t battery = sense_battery();
    if (!greeted)
        return;
    const int32_t *ticks = drive_ticks();
    struct telemetry telemetry = {
        .boot_nonce = nonce,
        .mcu_us = clock_us(),
        .ticks = {ticks[LEFT], ticks[RIGHT]},
        .pwm = {drive_pwm(LEFT), drive_pwm(RIGHT)},
        .status = status(),
        .faults = faults(battery),
        .battery_mv = battery,
        .setpoint_seq = applied ? applied_seq : 0,
        .crc_errors = broken,
        .overruns = overruns,
    };
    say(TELEMETRY, &telemetry, sizeof telemetry);
}
