#include "robot.h"

static avr_ioport_t *port_of(const struct robot *robot, struct pin pin)
{
    return robot->ports.by_letter[pin.port - 'A'];
}

int is_output(const struct robot *robot, struct pin pin)
{
    return robot->avr->data[port_of(robot, pin)->r_ddr] >> pin.bit & 1;
}

/* Whether the MCU drives the pin high; one that it doesn't drive is pulled down. */
int driven_high(const struct robot *robot, struct pin pin)
{
    return is_output(robot, pin) && robot->avr->data[port_of(robot, pin)->r_port] >> pin.bit & 1;
}

static struct input *find_input(struct robot *robot, struct pin pin)
{
    for (int i = 0; i < robot->input_count; i++)
        if (robot->inputs[i].pin.port == pin.port && robot->inputs[i].pin.bit == pin.bit)
            return &robot->inputs[i];
    struct input *fresh = &robot->inputs[robot->input_count];
    robot->input_count += robot->input_count < MAX_INPUTS - 1;
    fresh->pin = pin;
    return fresh;
}

/* A level on a wire. The port must know it too: else a pull-up wins over the wire at the next write to the port. */
void show(struct robot *robot, struct pin pin, int level)
{
    avr_ioport_t *port = port_of(robot, pin);
    uint8_t mask = (uint8_t)(1u << pin.bit);
    find_input(robot, pin)->level = level;
    port->external.pull_mask |= mask;
    port->external.pull_value = (uint8_t)((port->external.pull_value & ~mask) | (level ? mask : 0));
    avr_raise_irq(port->io.irq + pin.bit, level);
}

/* simavr forgets the levels at a reset, and passes a level on only where it changes. */
void show_all_again(struct robot *robot)
{
    for (int i = 0; i < robot->input_count; i++) {
        struct input *input = &robot->inputs[i];
        show(robot, input->pin, !input->level); /* turns it over, */
        show(robot, input->pin, !input->level); /* and back */
    }
}
