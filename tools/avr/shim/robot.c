#include "robot.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>

static void silent(avr_t *avr, const int level, const char *format, va_list arguments)
{
    (void)avr, (void)level, (void)format, (void)arguments;
}

static void no_sleep(avr_t *avr, avr_cycle_count_t how_long)
{
    (void)avr, (void)how_long;
}

static avr_cycle_count_t live(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    struct robot *robot = parameter;
    (void)avr;
    correct_byte_time(robot);
    for (int side = LEFT; side < SIDES; side++) {
        robot->duty[side] = duty(robot, side);
        if (robot->duty[side] != 0.0)
            robot->driven = when;
        turn(&robot->wheels[side], when);
    }
    return when + STEP;
}

static void find_modules(struct robot *robot)
{
    for (avr_io_t *io = robot->avr->io_port; io; io = io->next) {
        if (!strcmp(io->kind, "port"))
            robot->ports.by_letter[((avr_ioport_t *)io)->name - 'A'] = (avr_ioport_t *)io;
        else if (!strcmp(io->kind, "uart") && ((avr_uart_t *)io)->name == '0')
            robot->uart = (avr_uart_t *)io;
        else if (!strcmp(io->kind, "eeprom"))
            robot->eeprom = (avr_eeprom_t *)io;
    }
}

/* What simavr forgets at a reset: levels on the wires, and timers. */
static void after_reset(avr_io_t *io)
{
    struct robot *robot = (struct robot *)io;
    avr_t *avr = robot->avr;
    robot->resets++;
    robot->reset_at = avr->cycle;
    robot->deaf_since = 0;
    show_all_again(robot);
    for (int channel = 0; channel < ADC_CHANNELS; channel++)
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, channel), robot->millivolts[channel]);
    avr_cycle_timer_register(avr, STEP, live, robot);
    start_line(robot);
}

static void join(struct robot *robot)
{
    join_line(robot);
    robot->io.kind = "robot";
    robot->io.reset = after_reset;
    avr_register_io(robot->avr, &robot->io);
    for (int side = LEFT; side < SIDES; side++) {
        robot->wheels[side] = (struct wheel){.robot = robot, .side = side, .full_speed = 4000.0, .lag = 0.08, .goal = NAN};
        show_encoder(&robot->wheels[side]);
    }
}

struct robot *robot_new(const char *mcu, const uint8_t *flash, uint32_t size, const struct layout *layout)
{
    avr_global_logger_set(silent);
    avr_t *avr = avr_make_mcu_by_name(mcu);
    struct robot *robot = calloc(1, sizeof *robot);
    if (!avr || !robot || avr_init(avr) != 0)
        return NULL;
    avr->frequency = (uint32_t)HZ;
    avr->vcc = avr->avcc = avr->aref = 5000;
    avr->sleep = no_sleep;
    avr->run_cycle_limit = STEP;
    avr_loadcode(avr, (uint8_t *)flash, size, 0);
    avr->codeend = size;
    robot->avr = avr;
    find_modules(robot);
    robot->layout = *layout;
    join(robot);
    avr_reset(avr);
    robot->resets = 0;
    return robot;
}

void robot_free(struct robot *robot)
{
    avr_t *avr = robot->avr;
    avr_terminate(avr);
    free(avr);
    free(robot);
}

void robot_reset(struct robot *robot)
{
    avr_reset(robot->avr);
}

/* Runs to at least `cycle`; false once the program has crashed. */
int robot_run(struct robot *robot, uint64_t cycle)
{
    avr_t *avr = robot->avr;
    while (avr->cycle < cycle) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed)
            return 0;
        if (avr->sreg[S_I])
            robot->deaf_since = avr->cycle;
        else if (robot->deaf_since != 0 && avr->cycle - robot->deaf_since > robot->deaf_longest)
            robot->deaf_longest = avr->cycle - robot->deaf_since;
    }
    return 1;
}

uint64_t robot_cycle(const struct robot *robot) { return robot->avr->cycle; }
uint64_t robot_driven(const struct robot *robot) { return robot->driven; }
uint64_t robot_reset_at(const struct robot *robot) { return robot->reset_at; }
uint64_t robot_resets(const struct robot *robot) { return robot->resets; }
uint64_t robot_lost_bytes(const struct robot *robot) { return robot->lost_bytes; }
uint64_t robot_deaf_longest(const struct robot *robot) { return robot->deaf_longest; }
int robot_awake(const struct robot *robot) { return driven_high(robot, robot->layout.standby); }

void robot_show(struct robot *robot, char port, uint8_t bit, int level)
{
    show(robot, (struct pin){port, bit}, level);
}

void robot_volts(struct robot *robot, uint8_t channel, uint32_t millivolts)
{
    robot->millivolts[channel] = millivolts;
    avr_raise_irq(avr_io_getirq(robot->avr, AVR_IOCTL_ADC_GETIRQ, channel), millivolts);
}

/* What only a laboratory can do. */

int robot_eeprom_read(const struct robot *robot, uint16_t address) { return robot->eeprom->eeprom[address]; }
void robot_eeprom_write(struct robot *robot, uint16_t address, uint8_t byte) { robot->eeprom->eeprom[address] = byte; }

uint32_t robot_program_counter(const struct robot *robot) { return robot->avr->pc; }
int robot_interruptible(const struct robot *robot) { return robot->avr->sreg[S_I]; }

uint16_t robot_instruction(const struct robot *robot, uint32_t address)
{
    return (uint16_t)(robot->avr->flash[address] | robot->avr->flash[address + 1] << 8);
}

void robot_set_instruction(struct robot *robot, uint32_t address, uint16_t instruction)
{
    robot->avr->flash[address] = (uint8_t)instruction;
    robot->avr->flash[address + 1] = (uint8_t)(instruction >> 8);
}
