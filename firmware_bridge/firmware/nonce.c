#include "nonce.h"

#include "eeprom_map.h"
#include "framing.h"

#include <avr/eeprom.h>
#include <stdbool.h>

/* Two records used in turn, so that a power cut while one is written leaves the other: a counter half written could
 * repeat a number of long ago. Each byte lasts for 100,000 writes, the pair for twice as many boots. */
struct record {
    uint32_t boot;
    uint16_t crc;
};

#define RECORDS ((struct record *)EEPROM_NONCE)

static uint16_t checksum(const struct record *record)
{
    return crc16(&record->boot, sizeof record->boot);
}

static bool read(uint8_t index, struct record *record)
{
    eeprom_read_block(record, &RECORDS[index], sizeof *record);
    return record->crc == checksum(record);
}

uint32_t nonce_next(void)
{
    struct record record;
    uint32_t last = 0;
    uint8_t oldest = 0;
    for (uint8_t index = 0; index < 2; index++) {
        if (read(index, &record) && record.boot >= last) {
            last = record.boot;
            oldest = index ^ 1;
        }
    }
    record.boot = last + 1;
    record.crc = checksum(&record);
    eeprom_update_block(&record, &RECORDS[oldest], sizeof record);
    return record.boot;
}
