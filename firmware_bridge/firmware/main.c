/* Firmware of a two-wheeled base: the native protocol on a serial line, two wheels under closed-loop control.
 *
 * Three things stop the wheels without the main loop: the permission to drive, counted down in the timer interrupt
 * (motor.c); the hardware watchdog, fed only by a control step that was on time; and resistors that pull the driver's
 * inputs down while the MCU is in reset. */

#include "clock.h"
#include "config.h"
#include "drive.h"
#include "framing.h"
#include "motor.h"
#include "nonce.h"
#include "sense.h"
#include "session.h"
#include "uart.h"
#include "wheel.h"

#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stdbool.h>

#define CONTROL_MS (1000 / CONTROL_HZ)
#define REPORT_STEPS (20 / CONTROL_MS) /* telemetry every 20 ms */

/* Twelve control steps missed, and well inside the 250 ms a host may be silent. */
#define HANG_LIMIT WDTO_60MS

static struct decoder decoder;
static uint32_t due; /* when the next control step is */

/* After a watchdog reset the watchdog runs on, at its shortest: off, before start-up code can take longer. */
__attribute__((naked, used, section(".init3"))) static void tame_watchdog(void)
{
    MCUSR = 0;
    wdt_disable();
}

static void init(void)
{
    static const uint8_t END = 0; /* of the frame that the reset cut off: else the host adds the next one to it */
    motor_init();
    config_load();
    session_init(nonce_next());
    encoder_init();
    sense_init();
    uart_init();
    uart_write(&END, 1);
    clock_init();
    set_sleep_mode(SLEEP_MODE_IDLE);
    wdt_enable(HANG_LIMIT);
    sei();
}

static void receive(void)
{
    uint8_t byte;
    while (uart_read(&byte)) {
        const struct frame *frame = decoder_feed(&decoder, byte);
        if (frame)
            session_obey(frame);
    }
}

static bool control_due(void)
{
    return (int32_t)(clock_ms() - due) >= 0;
}

static void control(void)
{
    static uint8_t steps;
    due += CONTROL_MS;
    wdt_reset();
    sense_step();
    drive_step();
    if (++steps < REPORT_STEPS)
        return;
    steps = 0;
    session_report(decoder.broken, decoder.overruns);
}

/* Sleeps until an interrupt: each can be what the loop waits for. */
static void rest(void)
{
    cli();
    if (!uart_waiting() && !control_due()) {
        sleep_enable();
        sei(); /* takes effect after the next instruction: no interrupt slips in between */
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void)
{
    init();
    for (;;) {
        receive();
        if (config_work())
            session_configured();
        if (control_due())
            control();
        rest();
    }
}
