#include "uart.h"

#include "board.h"

#include <avr/interrupt.h>

/* 128 bytes are 11 ms of the line: the main loop comes round at least every millisecond. Powers of two, so that an
 * index wraps with a mask. */
#define SIZE 128
#define WRAP(index) ((uint8_t)(index) & (SIZE - 1))

/* 117647 baud, 2.1 % fast: what every Arduino has at "115200". */
#define DIVIDER 16

static volatile uint8_t received[SIZE], sent[SIZE];
static volatile uint8_t received_head, received_tail; /* head: written next; tail: read next; equal: empty */
static volatile uint8_t sent_head, sent_tail;

ISR(UART_RX_VECTOR)
{
    uint8_t byte = UDR0;
    uint8_t next = WRAP(received_head + 1);
    if (next == received_tail)
        return; /* full: the byte is lost, and the frame's CRC tells */
    received[received_head] = byte;
    received_head = next;
}

ISR(UART_TX_VECTOR)
{
    if (sent_tail == sent_head) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
        return;
    }
    UDR0 = sent[sent_tail];
    sent_tail = WRAP(sent_tail + 1);
}

void uart_init(void)
{
    UCSR0A = _BV(U2X0);
    UBRR0 = DIVIDER;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

bool uart_waiting(void)
{
    return received_tail != received_head;
}

bool uart_read(uint8_t *byte)
{
    if (!uart_waiting())
        return false;
    *byte = received[received_tail];
    received_tail = WRAP(received_tail + 1);
    return true;
}

bool uart_write(const uint8_t *bytes, uint8_t length)
{
    uint8_t head = sent_head;
    uint8_t room = WRAP(sent_tail - head - 1);
    if (length > room)
        return false;
    for (; length > 0; length--) {
        sent[head] = *bytes++;
        head = WRAP(head + 1);
    }
    sent_head = head;
    UCSR0B |= _BV(UDRIE0);
    return true;
}
