/* Frames of the native protocol: COBS( type | seq | payload | crc16 ) 00; see ../PROTOCOL.md. Touches no hardware. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#define FRAME_MAX_PAYLOAD 64
#define FRAME_MIN_BODY 4 /* type, seq, CRC */
#define FRAME_MAX_ENCODED (FRAME_MIN_BODY + FRAME_MAX_PAYLOAD + 1)

struct frame {
    uint8_t kind;
    uint8_t seq;
    uint8_t length; /* of the payload */
    const uint8_t *payload;
};

/* Collects one frame; a zeroed decoder is ready to use. */
struct decoder {
    uint8_t bytes[FRAME_MAX_ENCODED];
    uint8_t length;
    bool overrun;    /* more came than fits a frame: ignore the rest up to the next zero */
    uint16_t broken; /* wrong CRC, impossible COBS, or too short */
    uint16_t overruns;
    struct frame frame; /* the last one */
};

/* CRC-16/CCITT-FALSE, one byte more; begin with CRC_START. */
#define CRC_START 0xFFFF
uint16_t crc16_add(uint16_t crc, uint8_t byte);
uint16_t crc16(const void *data, uint8_t length);

/* Takes one byte from the line. Returns the frame that it ended, valid until the next call, or NULL. */
const struct frame *decoder_feed(struct decoder *decoder, uint8_t byte);

/* Writes a whole frame with its closing zero to `out` (room for FRAME_MAX_ENCODED + 1); returns its length. */
uint8_t frame_encode(const struct frame *frame, uint8_t *out);
