"""What a JPEG says of itself in its markers (ITU-T T.81 annex B), without decoding a pixel."""

from __future__ import annotations

import re

from omnibotd.core.errors import FrameError

SOI, EOI = b"\xff\xd8", b"\xff\xd9"

_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # those three are tables, not frames
_START_OF_SCAN = 0xDA
# In a scan, 0xFF is followed by a stuffed zero, a restart marker or fill bytes; anything else ends the scan.
_SCAN_ENDS = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")


def whole(data: bytes) -> tuple[bytes, tuple[int, int]]:
    """The picture without what lies behind it, and its (width, height).

    Raises FrameError for bytes that are no JPEG or one cut short. What lies behind is what a camera's buffer
    held before: V4L2 hands it out along with the picture.
    """
    if data[:2] != SOI:
        raise FrameError(f"{len(data)} bytes that are no JPEG: they begin with {data[:2].hex() or 'nothing'}")
    size: tuple[int, int] | None = None
    at = 2
    while (marker := data[at + 1 : at + 2]) and data[at] == 0xFF:
        code = marker[0]
        if code == 0xD9:
            return _checked(data[: at + 2], size)
        if code == 0xD8:  # the next picture begins: this one was cut
            break
        if code == 0xFF:  # a fill byte
            at += 1
            continue
        segment = at + 2
        if code in _START_OF_FRAME and len(data) >= segment + 7:
            size = (
                int.from_bytes(data[segment + 5 : segment + 7]),
                int.from_bytes(data[segment + 3 : segment + 5]),
            )
        at = segment + max(2, int.from_bytes(data[segment : segment + 2]))
        if code == _START_OF_SCAN:
            at = _end_of_scan(data, at)
    raise FrameError(f"JPEG of {len(data)} bytes is cut short or damaged at byte {min(at, len(data))}")


def _end_of_scan(data: bytes, at: int) -> int:
    found = _SCAN_ENDS.search(data, at)
    return len(data) if found is None else found.start()


def _checked(data: bytes, size: tuple[int, int] | None) -> tuple[bytes, tuple[int, int]]:
    if size is None or 0 in size:
        raise FrameError(f"JPEG of {len(data)} bytes holds no picture")
    return data, size
