"""Frames of the native protocol: `COBS( type u8 | seq u8 | payload | crc16 LE ) 00`; see PROTOCOL.md."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from dataclasses import dataclass

from cobs import cobs

from firmware_bridge.events import BridgeError

DELIMITER = b"\0"
MAX_PAYLOAD = 64  # what an AVR with 2 kB of RAM can buffer twice and send in 6 ms at 115200 baud
MIN_BODY = 4  # type, seq, CRC
MAX_ENCODED = MIN_BODY + MAX_PAYLOAD + 1  # COBS adds one byte to anything shorter than 255


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame whose CRC was right; what the payload means is not yet known."""

    kind: int
    seq: int
    payload: bytes


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, nothing reflected."""
    return crc_hqx(data, 0xFFFF)


def encode(kind: int, seq: int, payload: bytes) -> bytes:
    """Bytes of one frame for the line, closing zero included; BridgeError if it can't be one."""
    if len(payload) > MAX_PAYLOAD:
        raise BridgeError(f"a payload of {len(payload)} bytes does not fit a frame (at most {MAX_PAYLOAD})")
    body = bytes((kind, seq)) + payload
    encoded: bytes = cobs.encode(body + struct.pack("<H", crc16(body)))
    return encoded + DELIMITER


class Decoder:
    """Finds frames in whatever comes from the line; a broken one costs nothing beyond the next zero byte.

    The counters say what was thrown away: `crc_errors` frames with a wrong checksum, `overruns` runs of bytes
    longer than any frame, `garbage` runs that are no COBS or too short.
    """

    def __init__(self) -> None:
        self.crc_errors = 0
        self.overruns = 0
        self.garbage = 0
        self._partial = bytearray()  # never above MAX_ENCODED: more can't become a frame
        self._overrun = False

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes in pieces of any size; returns the frames they complete, in order."""
        *ended, rest = bytes(data).split(DELIMITER)
        frames = []
        for piece in ended:
            self._extend(piece)
            frame = self._finish()
            if frame is not None:
                frames.append(frame)
        self._extend(rest)
        return frames

    def _extend(self, piece: bytes) -> None:
        if self._overrun:
            return
        if len(self._partial) + len(piece) > MAX_ENCODED:
            self._overrun = True
            self.overruns += 1
            self._partial.clear()
            return
        self._partial += piece

    def _finish(self) -> Frame | None:
        encoded = bytes(self._partial)
        self._partial.clear()
        self._overrun = False
        return self._open(encoded) if encoded else None  # zeros in a row are allowed, as padding

    def _open(self, encoded: bytes) -> Frame | None:
        try:
            body = cobs.decode(encoded)
        except cobs.DecodeError:
            self.garbage += 1
            return None
        if len(body) < MIN_BODY:
            self.garbage += 1
            return None
        content, (crc,) = body[:-2], struct.unpack("<H", body[-2:])
        if crc16(content) != crc:
            self.crc_errors += 1
            return None
        return Frame(content[0], content[1], content[2:])
