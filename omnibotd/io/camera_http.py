"""Frames of an MJPEG stream: multipart/x-mixed-replace over HTTP, as network cameras send it."""

from __future__ import annotations

import http.client
import re
import time
from collections.abc import Generator
from urllib.parse import urlsplit

from omnibotd.core.vision.frame import Frame
from omnibotd.io.camera_errors import CameraError
from omnibotd.io.camera_jpeg import EOI, SOI

MAX_PART = 8 << 20  # bytes; a 4096 x 4096 JPEG of good quality is below
TIMEOUT = 2.0  # seconds to connect, and of silence; a stalled stream is given up before, this ends its reader
FRAME_TIMEOUT = 5.0  # a stream that drips bytes but completes no picture

_BLANK_LINE = re.compile(rb"\r?\n\r?\n")
_CONTENT_LENGTH = re.compile(rb"content-length:[ \t]*(\d{1,12})", re.IGNORECASE)


class MultipartJpegs:
    """Parser of the stream's body, without I/O: bytes in, the bodies of complete parts out.

    A part ends by its Content-Length, else by its JPEG markers. A broken part costs itself only: at the
    next header the parser is in step again.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._in_body = False
        self._length: int | None = None
        self._searched = 0  # bytes known to hold no end of picture: a slow giant isn't searched from its start

    def feed(self, data: bytes) -> list[bytes]:
        """Parts completed by `data`; raises CameraError for a part above MAX_PART."""
        self._buffer += data
        parts = []
        while (part := self._next_part()) is not None:
            parts.append(part)
        if max(len(self._buffer), self._length or 0) > MAX_PART:
            raise CameraError(f"the stream sends a part of more than {MAX_PART >> 20} MB")
        return parts

    def _next_part(self) -> bytes | None:
        if not self._in_body and not self._read_header():
            return None
        end = self._end_of_marked() if self._length is None else self._length
        if end is None or end > len(self._buffer):
            return None
        part = bytes(self._buffer[:end])
        del self._buffer[:end]
        self._in_body, self._length, self._searched = False, None, 0
        return part

    def _read_header(self) -> bool:
        """Take boundary and header lines up to the blank one; True when they are complete."""
        del self._buffer[: len(self._buffer) - len(self._buffer.lstrip(b"\r\n"))]
        blank = _BLANK_LINE.search(self._buffer)
        if blank is None:
            return False
        # The last length counts: after a part longer than it claimed, its tail stands before the real header.
        lengths = _CONTENT_LENGTH.findall(self._buffer, 0, blank.start())
        self._length = int(lengths[-1]) if lengths else None
        self._in_body = True
        del self._buffer[: blank.end()]
        return True

    def _end_of_marked(self) -> int | None:
        """Length of a body that ends with its picture; what precedes the picture is dropped."""
        end = self._buffer.find(EOI, self._searched)
        if end < 0:
            self._searched = max(0, len(self._buffer) - 1)
            return None
        del self._buffer[: max(0, self._buffer.rfind(SOI, 0, end))]
        return self._buffer.find(EOI) + 2


def http_frames(url: str) -> Generator[Frame]:
    """Frames of the stream at `url` until it ends, which is a CameraError as all else that goes wrong."""
    try:
        yield from _frames(url)
    except (CameraError, OSError, http.client.HTTPException) as error:
        raise CameraError(f"{url}: {error}") from error
    raise CameraError(f"{url}: the stream ended")


def _frames(url: str) -> Generator[Frame]:
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port or 80, timeout=TIMEOUT)
    try:
        connection.request("GET", (parts.path or "/") + (f"?{parts.query}" if parts.query else ""))
        with connection.getresponse() as response:
            _check(response)
            yield from _bodies(response)
    finally:
        connection.close()


def _bodies(response: http.client.HTTPResponse) -> Generator[Frame]:
    parser = MultipartJpegs()
    last = time.monotonic()
    while data := response.read1(1 << 16):
        now = time.monotonic()
        for part in parser.feed(data):
            last = now
            yield Frame(now, part)
        if now - last > FRAME_TIMEOUT:
            raise CameraError(f"no whole picture for {FRAME_TIMEOUT:g} s")


def _check(response: http.client.HTTPResponse) -> None:
    if response.status != 200:
        raise CameraError(f"the server answers {response.status} {response.reason}")
    kind = response.headers.get_content_type()
    if not kind.startswith("multipart/"):
        raise CameraError(f"the server sends {kind}, expected an MJPEG stream (multipart/x-mixed-replace)")
