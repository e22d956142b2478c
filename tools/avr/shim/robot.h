/* A robot's body round a simulated AVR: bytes in and out, wheels with encoders, contacts, battery. For ctypes.
 *
 * simavr is under the GPL 3: this is a test tool, compiled where it is used, and no part of omnibotd links it. */
#pragma once

#include <stdint.h>

#include <simavr/avr_eeprom.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_io.h>

#define HZ 16000000.0
#define STEP 1600        /* cycles of the body's step: 0.1 ms, which is how exactly "motors off" is timed */
#define QUEUE (1u << 16) /* bytes each way: six seconds of the line */
#define MAX_INPUTS 16
#define ADC_CHANNELS 8

enum { LEFT, RIGHT, SIDES };

struct pin {
    char port;
    uint8_t bit;
};

struct layout {
    struct pin standby, pwm[SIDES], forward[SIDES], backward[SIDES], channel_a[SIDES], channel_b[SIDES];
};

struct robot;

struct wheel {
    struct robot *robot;
    int side;
    double full_speed; /* ticks/s at full PWM; negative: the motor's wires are swapped */
    double lag;        /* s; 0: the wheel turns at `speed`, whatever is driven */
    double friction;   /* share of full PWM that turns nothing */
    double speed;      /* ticks/s */
    double angle;      /* ticks, at the start of the step */
    uint64_t since;    /* when that was */
    double goal;       /* where a wheel that is rolled by hand stops; NAN: nowhere */
    int64_t edge;      /* encoder edges shown to the MCU so far */
    int unplugged;     /* the encoder's wires are off */
};

struct queue {
    uint8_t bytes[QUEUE];
    uint32_t head, tail; /* run on; modulo QUEUE */
};

/* simavr's own record of each port, found once: asking by ioctl walks through all modules each time. */
struct ports {
    avr_ioport_t *by_letter['L' - 'A' + 1];
};

struct input {
    struct pin pin;
    int level;
};

struct robot {
    avr_io_t io; /* first: simavr calls `reset` with its address */
    avr_t *avr;
    avr_uart_t *uart;
    avr_eeprom_t *eeprom;
    struct ports ports;
    struct layout layout;
    struct wheel wheels[SIDES];
    double duty[SIDES]; /* share of the supply on each motor */
    struct queue to_mcu, to_host;
    struct input inputs[MAX_INPUTS];
    int input_count;
    uint32_t millivolts[ADC_CHANNELS];
    uint64_t driven; /* the last step at which a motor was driven */
    uint64_t resets, reset_at; /* how often it started anew, and when it last did */
    uint64_t lost_bytes; /* came while the UART was full */
    uint64_t byte_time;  /* cycles, as corrected */
    uint64_t deaf_since, deaf_longest; /* interrupts off, in cycles */
};

/* pins.c: whether the MCU drives a pin high, and a level on a wire to it. */
int is_output(const struct robot *robot, struct pin pin);
int driven_high(const struct robot *robot, struct pin pin);
void show(struct robot *robot, struct pin pin, int level);
void show_all_again(struct robot *robot);

/* wheels.c: the share of the supply on a motor; a wheel's motion up to cycle `now`; its encoder's channels. */
double duty(const struct robot *robot, int side);
void turn(struct wheel *wheel, uint64_t now);
void show_encoder(struct wheel *wheel);

/* line.c: joins the UART, starts the line anew, and mends simavr's idea of a byte's length. */
void join_line(struct robot *robot);
void start_line(struct robot *robot);
void correct_byte_time(struct robot *robot);
