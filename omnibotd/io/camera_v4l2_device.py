"""A V4L2 device by its file descriptor: what it can do, its controls, its buffers. Needs neither numpy nor OpenCV."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import select
from collections.abc import Callable, Iterator
from contextlib import suppress
from ctypes import c_int32
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeVar

from omnibotd.io import camera_v4l2_abi as abi
from omnibotd.io.camera_errors import CameraError
from omnibotd.io.camera_v4l2_modes import FORMATS, Mode, Wanted

# One being filled, one filled, one being copied. With fewer, the camera has nowhere to put the frame that starts
# meanwhile, and the rate is halved; more would only hold older frames.
BUFFERS = 3
MOST_ENTRIES = 256  # of any list that the driver has; a webcam has up to 20 sizes of a format
_LONGEST = Fraction(60)  # s between frames that anybody would offer: a driver that says more says nonsense

_Asked = TypeVar("_Asked")


@dataclass(frozen=True, slots=True)
class Shot:
    """One filled buffer, copied: `stamp` of the driver's monotonic clock, None where it has another."""

    data: bytes
    stamp: float | None
    damaged: bool


@dataclass(frozen=True, slots=True)
class Layout:
    """What the driver settled on: pixel format, size, bytes from one line to the next."""

    fourcc: str
    width: int
    height: int
    stride: int


class Device:
    """An open camera. Every method raises OSError where the driver refuses; none waits but `newest`."""

    def __init__(self, path: str) -> None:
        """Open it; raises CameraError for what is no camera, OSError where it can't be opened."""
        self._path = path
        self._maps: list[mmap.mmap] = []
        # A name such as /dev/v4l/by-id/... is a link, which after a replug leads elsewhere.
        self._fd = os.open(os.path.realpath(path), os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            self.card = self._identify()
        except BaseException:
            os.close(self._fd)
            raise

    def close(self) -> None:
        """Stop streaming and let go of the buffers, as far as the device is still there."""
        with suppress(OSError):
            self.ask(abi.STREAMOFF, c_int32(abi.CAPTURE))
        for buffer in self._maps:
            buffer.close()
        self._maps.clear()
        os.close(self._fd)

    def _identify(self) -> str:
        try:
            told = self.ask(abi.QUERYCAP, abi.Capability())
        except OSError as error:
            raise CameraError(f"{self._path}: is no video device ({error.strerror})") from error
        can = told.device_caps if told.capabilities & abi.CAP_DEVICE_CAPS else told.capabilities
        if not can & abi.CAP_VIDEO_CAPTURE or not can & abi.CAP_STREAMING:
            raise CameraError(
                f"{self._path}: belongs to {_text(told.card)!r} but gives no pictures; cameras have a second device, "
                "mostly the one with the lower number"
            )
        return _text(told.card)

    def ask(self, request: int, argument: _Asked) -> _Asked:
        """One ioctl, again where a signal came in between; the interpreter's lock is not held meanwhile."""
        while True:
            try:
                fcntl.ioctl(self._fd, request, argument, True)  # type: ignore[call-overload]
            except InterruptedError:
                continue
            return argument

    # ---- what it offers

    def modes(self, wanted: Wanted) -> list[Mode]:
        """All that we can read, of ranges what is nearest to the wanted; what it does not tell, it is asked for."""
        return [
            Mode(fourcc, width, height, interval)
            for fourcc in self.formats()
            if fourcc in FORMATS
            for width, height in self._sizes(fourcc, wanted)
            for interval in self._intervals(fourcc, width, height, wanted)
        ]

    def formats(self) -> list[str]:
        descriptions = self._listed(abi.ENUM_FMT, lambda: abi.FormatDescription(type=abi.CAPTURE))
        return [abi.fourcc(told.pixelformat) for told in descriptions]

    def _sizes(self, fourcc: str, wanted: Wanted) -> list[tuple[int, int]]:
        sizes = []
        for told in self._listed(abi.ENUM_FRAMESIZES, lambda: abi.FrameSize(pixel_format=abi.code_of(fourcc))):
            span = told.range
            if told.type == abi.DISCRETE:
                sizes.append((span.min_width, span.max_width))
                continue
            width = _on_grid(wanted.width, span.min_width, span.max_width, span.step_width)
            return [(width, _on_grid(wanted.height, span.min_height, span.max_height, span.step_height))]
        return [size for size in sizes if min(size) > 0] or [(wanted.width, wanted.height)]

    def _intervals(self, fourcc: str, width: int, height: int, wanted: Wanted) -> list[Fraction]:
        asked = Fraction(1 / wanted.fps).limit_denominator(10_000)
        intervals = []
        for told in self._listed(
            abi.ENUM_FRAMEINTERVALS,
            lambda: abi.FrameInterval(pixel_format=abi.code_of(fourcc), width=width, height=height),
        ):
            if told.type != abi.DISCRETE:
                return [min(max(asked, _seconds(told.shortest) or asked), _seconds(told.longest) or asked)]
            intervals.append(_seconds(told.shortest))
        return [interval for interval in intervals if interval] or [asked]

    def _listed(self, request: int, entry: Callable[[], _Asked]) -> Iterator[_Asked]:
        for index in range(MOST_ENTRIES):
            told = entry()
            told.index = index  # type: ignore[attr-defined]
            try:
                yield self.ask(request, told)
            except OSError as error:
                if error.errno in (errno.EINVAL, errno.ENOTTY):  # the end of the list, or no list at all
                    return
                raise

    # ---- what it is told

    def use(self, mode: Mode) -> tuple[Layout, Mode]:
        """Set the mode; what the driver made of it, which may differ. CameraError: a format that we can't read."""
        form = abi.Format(type=abi.CAPTURE)
        form.pix.width, form.pix.height, form.pix.field = mode.width, mode.height, abi.ANY_FIELD
        form.pix.pixelformat = abi.code_of(mode.fourcc)
        pix = self.ask(abi.S_FMT, form).pix
        layout = Layout(abi.fourcc(pix.pixelformat), pix.width, pix.height, pix.bytesperline)
        if layout.fourcc not in FORMATS:
            raise CameraError(f"{self._path}: gives {layout.fourcc}, expected one of {', '.join(FORMATS)}")
        return layout, Mode(layout.fourcc, layout.width, layout.height, self._paced(mode.interval))

    def _paced(self, interval: Fraction) -> Fraction:
        """Set the rate, where the driver lets us; the seconds between frames that it settled on."""
        try:
            told = self.ask(abi.G_PARM, abi.CaptureParameters(type=abi.CAPTURE))
            if told.capability & abi.CAP_TIMEPERFRAME:
                told.timeperframe = abi.Fraction(interval.numerator, interval.denominator)
                told = self.ask(abi.S_PARM, told)
        except OSError:  # a driver without rates
            return interval
        return _seconds(told.timeperframe) or interval

    def control(self, number: int) -> abi.ControlRange | None:
        """Range of a control, None where the camera has none that could be set."""
        try:
            told = self.ask(abi.QUERYCTRL, abi.ControlRange(id=number))
        except OSError:
            return None
        return None if told.flags & (abi.CTRL_DISABLED | abi.CTRL_READ_ONLY) else told

    def get(self, number: int) -> int:
        value: int = self.ask(abi.G_CTRL, abi.Control(id=number)).value
        return value

    def set(self, number: int, value: int) -> None:
        self.ask(abi.S_CTRL, abi.Control(id=number, value=value))

    # ---- its buffers

    def start(self) -> None:
        """Give it buffers and let it stream. OSError EBUSY: another program streams."""
        count = self.ask(abi.REQBUFS, abi.RequestBuffers(BUFFERS, abi.CAPTURE, abi.MMAP)).count
        for index in range(count):
            told = self.ask(abi.QUERYBUF, self._buffer(index))
            self._maps.append(mmap.mmap(self._fd, told.length, offset=told.place.offset))
            self.ask(abi.QBUF, self._buffer(index))
        self.ask(abi.STREAMON, c_int32(abi.CAPTURE))

    def newest(self, timeout: float) -> Shot | None:
        """The newest picture that is there or comes in `timeout` s; older ones are dropped. OSError: it is gone."""
        readable, _, _ = select.select([self._fd], [], [], timeout)
        filled = self._dequeued() if readable else None
        while filled is not None and (newer := self._dequeued()) is not None:
            self.ask(abi.QBUF, self._buffer(filled.index))
            filled = newer
        return None if filled is None else self._copied(filled)

    def _dequeued(self) -> abi.Buffer | None:
        try:
            return self.ask(abi.DQBUF, self._buffer(0))
        except BlockingIOError:
            return None

    def _copied(self, filled: abi.Buffer) -> Shot:
        """What is in the buffer, which goes back to the driver at once."""
        data = self._maps[filled.index][: filled.bytesused]
        monotonic = filled.flags & abi.BUF_CLOCK == abi.BUF_CLOCK_MONOTONIC
        stamp = filled.seconds + filled.microseconds * 1e-6 if monotonic else None
        self.ask(abi.QBUF, self._buffer(filled.index))
        return Shot(data, stamp, bool(filled.flags & abi.BUF_ERROR))

    @staticmethod
    def _buffer(index: int) -> abi.Buffer:
        return abi.Buffer(index=index, type=abi.CAPTURE, memory=abi.MMAP)


def _on_grid(value: int, low: int, high: int, step: int) -> int:
    """The value of the range that is nearest."""
    step = max(step, 1)
    return min(max(low + round((value - low) / step) * step, low), low + (high - low) // step * step)


def _seconds(told: abi.Fraction) -> Fraction | None:
    """None for what is no time between frames."""
    if told.numerator == 0 or told.denominator == 0:
        return None
    seconds = Fraction(told.numerator, told.denominator)
    return seconds if seconds <= _LONGEST else None


def _text(name: bytes) -> str:
    return name.decode("utf-8", "replace")
