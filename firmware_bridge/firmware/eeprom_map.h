/* Where things stand in EEPROM, the same in all versions of the firmware: an update must not lose them. Address 0 stays
 * free: a falling supply that writes somewhere by mistake writes there. */
#pragma once

#define EEPROM_NONCE 16  /* 12 bytes */
#define EEPROM_CONFIG 32 /* 25 bytes */
