/* The serial line, 115200 8N1, by interrupt in both directions. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

/* True and the next byte received, or false. */
bool uart_read(uint8_t *byte);

/* Whether uart_read would have a byte. */
bool uart_waiting(void);

/* Queues all of `bytes`, or none where there is no room: half a frame helps nobody. */
bool uart_write(const uint8_t *bytes, uint8_t length);
