/* Which boot this is: a number that differs from that of every boot before. */
#pragma once

#include <stdint.h>

/* Takes the next number and stores it; waits for the EEPROM (20 ms), so before anything moves. */
uint32_t nonce_next(void);
