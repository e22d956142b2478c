"""A USB webcam (UVC 1.0, MJPEG over a bulk endpoint), as the kernel's `uvcvideo` expects one.

Written from the USB Video Class specification; what Linux reads of it is what is here. The owner shows it pictures,
`RedirSession` carries its transfers.
"""

from __future__ import annotations

import struct

from tools.sim.usb_redir import TO_HOST, Endpoint, Identity, Interface, RedirSession, Setup

VENDOR, PRODUCT = 0x1D6B, 0x0102  # the Linux Foundation's webcam gadget: nobody's real product
_CONTROL_INTERFACE, _STREAM_INTERFACE = 0, 1
_STREAM = 0x81
_INPUT, _OUTPUT = 1, 2  # units of the control interface
_CAMERA, _USB = 0x0201, 0x0101  # what these are
_VIDEO, _CONTROL, _STREAMING, _COLLECTION = 0x0E, 1, 2, 3
_PACKET_SIZE = 512
_TICKS = 10_000_000  # of 100 ns in a second: the unit of frame intervals
# Descriptor types, and bits of the two bytes that precede each frame.
_DEVICE_TYPE, _CONFIGURATION_TYPE, _STRING_TYPE = 1, 2, 3
_END_OF_HEADER, _END_OF_FRAME = 0x80, 0x02
_SET_CUR, _GET_CUR, _GET_MIN, _GET_MAX, _GET_LEN, _GET_INFO, _GET_DEF = 0x01, 0x81, 0x82, 0x83, 0x85, 0x86, 0x87
_GET_DESCRIPTOR = 6
_PROBE, _COMMIT = 1, 2
_PROBE_SIZE = 26
_READ_AND_SET = b"\x03"


class UvcCamera:
    """One webcam; it offers one size at some rates. `show` is the shutter, `session` the cable."""

    identity = Identity(VENDOR, PRODUCT, 0x0100, 0xEF, 2, 1)
    interfaces = (
        Interface(_CONTROL_INTERFACE, _VIDEO, _CONTROL),
        Interface(_STREAM_INTERFACE, _VIDEO, _STREAMING),
    )
    endpoints = (Endpoint(_STREAM, _STREAM_INTERFACE, _PACKET_SIZE),)

    def __init__(self, width: int, height: int, rates: tuple[int, ...] = (15, 10, 5), serial: str = "SIM0001") -> None:
        self._size = width, height
        self._intervals = tuple(_TICKS // rate for rate in rates)
        self._names = ("omnibotd", "Simulated ceiling camera", serial)
        self._largest = width * height * 2
        self._interval = self._intervals[0]
        self.session: RedirSession | None = None
        self.frozen = False  # says nothing more, and stays plugged in
        self.frames = 0  # that went out whole
        self._rest: bytes | None = None  # of the frame that is on its way; empty: its end is still to be told
        self._parity = 0

    def show(self, jpeg: bytes) -> None:
        """A picture is ready; dropped while the one before it is still on its way, or nobody asks for pictures."""
        if self.session is None or not self.session.wanted or self._rest is not None or self.frozen:
            return
        self._rest = bytes([2, _END_OF_HEADER | _END_OF_FRAME | self._parity]) + jpeg
        self._parity ^= 1
        self.pump()

    def pump(self) -> None:
        """Fill what the host has room for; to be called whenever the session has received."""
        session = self.session
        while session is not None and self._rest is not None and not self.frozen and (room := session.wanted):
            part, self._rest = self._rest[:room], self._rest[room:]
            session.answer(part)
            if len(part) < room:  # a short transfer ends the frame
                self._rest = None
                self.frames += 1

    def configured(self) -> None:
        self._rest = None

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        """Standard requests for descriptors, and the stream's negotiation; all else stalls."""
        kind, recipient = setup.kind & 0x60, setup.index & 0xFF
        if kind == 0:
            return self._standard(setup)
        if kind == 0x20 and recipient == _STREAM_INTERFACE and setup.value >> 8 in (_PROBE, _COMMIT):
            return self._negotiate(setup, data)
        return None

    def _standard(self, setup: Setup) -> bytes | None:
        if not setup.kind & TO_HOST:
            self._rest = None  # CLEAR_FEATURE: the host ends a stream
            return b""
        if setup.request != _GET_DESCRIPTOR:
            return b"\0\0"  # GET_STATUS
        kind = setup.value >> 8
        if kind == _DEVICE_TYPE:
            return self._device_descriptor()
        if kind == _CONFIGURATION_TYPE:
            return self._configuration_descriptor()
        return self._string(setup.value & 0xFF) if kind == _STRING_TYPE else None

    def _negotiate(self, setup: Setup, data: bytes) -> bytes | None:
        """The host asks for a frame interval and is told what it gets."""
        if setup.request == _SET_CUR and len(data) >= 8:
            (asked,) = struct.unpack_from("<I", data, 4)
            self._interval = min(self._intervals, key=lambda interval: abs(interval - asked))
            return b""
        if setup.request in (_GET_CUR, _GET_MIN, _GET_MAX, _GET_DEF):
            return self._stream_settings()
        return {_GET_LEN: struct.pack("<H", _PROBE_SIZE), _GET_INFO: _READ_AND_SET}.get(setup.request)

    def _stream_settings(self) -> bytes:
        whole = self._largest + 2  # a frame and its header in one payload
        return struct.pack("<HBBIHHHHHII", 1, 1, 1, self._interval, 0, 0, 0, 0, 0, self._largest, whole)

    def _device_descriptor(self) -> bytes:
        who = self.identity
        numbers = (who.usb_class, who.subclass, who.protocol, 64, who.vendor, who.product, who.release)
        return struct.pack("<BBHBBBBHHHBBBB", 18, _DEVICE_TYPE, 0x0200, *numbers, 1, 2, 3, 1)

    def _string(self, index: int) -> bytes | None:
        if index == 0:
            return bytes([4, _STRING_TYPE, 0x09, 0x04])  # there is US English
        if index > len(self._names):
            return None
        text = self._names[index - 1].encode("utf-16le")
        return bytes([2 + len(text), _STRING_TYPE]) + text

    def _configuration_descriptor(self) -> bytes:
        body = _association() + _control_interface() + self._stream_interface()
        return struct.pack("<BBHBBBBB", 9, _CONFIGURATION_TYPE, 9 + len(body), 2, 1, 0, 0x80, 250) + body

    def _stream_interface(self) -> bytes:
        """One alternate setting, as bulk needs no others; one MJPEG format with one frame size."""
        units = self._format() + self._frame() + bytes([6, 0x24, 0x0D, 1, 1, 4])  # colours: sRGB
        size = 14 + len(units)
        header = struct.pack("<BBBBHBBBBBBBB", 14, 0x24, 1, 1, size, _STREAM, 0, _OUTPUT, 0, 0, 0, 1, 0)
        endpoint = struct.pack("<BBBBHB", 7, 5, _STREAM, 2, _PACKET_SIZE, 0)
        return bytes([9, 4, _STREAM_INTERFACE, 0, 1, _VIDEO, _STREAMING, 0, 0]) + header + units + endpoint

    def _format(self) -> bytes:
        return bytes([11, 0x24, 6, 1, 1, 1, 1, 0, 0, 0, 0])

    def _frame(self) -> bytes:
        fastest, slowest = min(self._intervals), max(self._intervals)
        bits = [self._largest * 8 * _TICKS // interval for interval in (slowest, fastest)]
        width, height = self._size
        count = len(self._intervals)
        numbers = (26 + 4 * count, 0x24, 7, 1, 0, width, height, *bits, self._largest, self._intervals[0], count)
        return struct.pack(f"<BBBBBHHIIIIB{count}I", *numbers, *sorted(self._intervals))


def _association() -> bytes:
    """Both interfaces are one function."""
    return bytes([8, 0x0B, _CONTROL_INTERFACE, 2, _VIDEO, _COLLECTION, 0, 2])


def _control_interface() -> bytes:
    """A camera without controls, and where its pictures go."""
    camera = struct.pack("<BBBBHBBHHHB3x", 18, 0x24, 2, _INPUT, _CAMERA, 0, 0, 0, 0, 0, 3)
    output = struct.pack("<BBBBHBBB", 9, 0x24, 3, _OUTPUT, _USB, 0, _INPUT, 0)
    size = 13 + len(camera) + len(output)
    header = struct.pack("<BBBHHIBB", 13, 0x24, 1, 0x0100, size, 6_000_000, 1, _STREAM_INTERFACE)
    return bytes([9, 4, _CONTROL_INTERFACE, 0, 0, _VIDEO, _CONTROL, 0, 2]) + header + camera + output
