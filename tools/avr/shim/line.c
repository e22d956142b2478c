#include "robot.h"

#define BYTE 1389    /* cycles of a byte at 115200 baud */
#define UART_DEPTH 3 /* what an AVR holds unread: two bytes, and one in its shift register */

DEFINE_FIFO(uint16_t, uart_fifo); /* the functions to look into simavr's UART with */

static void push(struct queue *queue, uint8_t byte)
{
    if (queue->head - queue->tail < QUEUE)
        queue->bytes[queue->head++ % QUEUE] = byte;
}

static avr_cycle_count_t deliver(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    struct robot *robot = parameter;
    struct queue *queue = &robot->to_mcu;
    (void)avr;
    if (queue->head == queue->tail)
        return 0;
    uint8_t byte = queue->bytes[queue->tail++ % QUEUE];
    if (uart_fifo_get_read_size(&robot->uart->input) >= UART_DEPTH)
        robot->lost_bytes++;
    else
        avr_raise_irq(robot->uart->io.irq + UART_IRQ_INPUT, byte);
    return when + BYTE;
}

static void byte_from_mcu(avr_irq_t *irq, uint32_t value, void *parameter)
{
    struct robot *robot = parameter;
    (void)irq;
    push(&robot->to_host, (uint8_t)value);
}

/* simavr counts a parity bit that 8N1 does not have: a byte takes ten bits, not eleven. */
void correct_byte_time(struct robot *robot)
{
    if (robot->uart->cycles_per_byte == robot->byte_time)
        return;
    robot->byte_time = robot->uart->cycles_per_byte = robot->uart->cycles_per_byte * 10 / 11;
}

void join_line(struct robot *robot)
{
    uint32_t quiet = 0;
    avr_ioctl(robot->avr, AVR_IOCTL_UART_SET_FLAGS('0'), &quiet);
    avr_irq_register_notify(robot->uart->io.irq + UART_IRQ_OUTPUT, byte_from_mcu, robot);
}

void start_line(struct robot *robot)
{
    avr_cycle_timer_register(robot->avr, BYTE, deliver, robot);
}

/* Bytes from the host; they arrive one after the other at the speed of the line. */
void robot_send(struct robot *robot, const uint8_t *bytes, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++)
        push(&robot->to_mcu, bytes[i]);
    if (avr_cycle_timer_status(robot->avr, deliver, robot) == 0)
        avr_cycle_timer_register(robot->avr, 0, deliver, robot);
}

uint32_t robot_sending(const struct robot *robot) { return robot->to_mcu.head - robot->to_mcu.tail; }

uint32_t robot_receive(struct robot *robot, uint8_t *bytes, uint32_t room)
{
    struct queue *queue = &robot->to_host;
    uint32_t count = 0;
    while (count < room && queue->tail != queue->head)
        bytes[count++] = queue->bytes[queue->tail++ % QUEUE];
    return count;
}
