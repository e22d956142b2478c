"""A stand-in for the kernel's V4L2: answers ioctls on a FIFO as <linux/videodev2.h> lays them out.

Layouts are `struct` formats, written from the header and not from the module under test.
"""

import errno
import os
import struct
from dataclasses import dataclass, field
from types import SimpleNamespace

from omnibotd.io import camera_v4l2_device

VIDEO, META = 0x84200001, 0x84A00000  # device_caps of a webcam's two nodes
PAGE = 4096
MONOTONIC = 0x2000
BUFFER = struct.Struct("@IIIIIllII8sIILIIi0L")  # index type bytesused flags field sec usec timecode sequence ... length


@dataclass
class Kernel:
    """One camera. `formats`: fourcc -> {(width, height): [(numerator, denominator), ...]}, None: lists none."""

    formats: dict
    caps: int = VIDEO
    controls: dict = field(default_factory=dict)  # id -> [minimum, maximum, step, default, value]
    size_range: tuple = ()  # min, max, step of width and of height, instead of discrete sizes
    interval_range: tuple = ()
    stride: int = 0
    refuse: dict = field(default_factory=dict)  # ioctl number -> errno
    settle: tuple = ()  # fourcc, width, height that S_FMT makes of all wishes
    clock: int = MONOTONIC
    refill: bytes = b""  # a picture that is ready again whenever a buffer is queued

    def __post_init__(self):
        self.asked_format = self.asked_interval = None
        self.queued, self.filled, self.buffers = [], [], []
        self.streaming = False

    def install(self, path, monkeypatch):
        os.mkfifo(path)
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        monkeypatch.setattr(camera_v4l2_device, "fcntl", SimpleNamespace(ioctl=self.ioctl))
        monkeypatch.setattr(camera_v4l2_device, "mmap", SimpleNamespace(mmap=self.mmap))

    def expose(self, data, stamp, flags=0):
        """A picture goes into the next queued buffer; it is lost where there is none."""
        if self.queued:
            index = self.queued.pop(0)
            self.buffers[index][: len(data)] = data
            self.filled.append((index, len(data), stamp, flags | self.clock))
            os.write(self.fd, b"x")

    def unplug(self):
        self.refuse[17] = errno.ENODEV
        os.write(self.fd, b"x")

    def mmap(self, fd, length, offset):
        assert offset % PAGE == 0
        return self.buffers[offset // PAGE]

    def ioctl(self, fd, request, argument, mutate):
        data = memoryview(argument).cast("B")
        number, size = request & 0xFF, request >> 16 & 0x3FFF
        assert size == len(data), f"ioctl {number} says {size} bytes, brings {len(data)}"
        if number in self.refuse:
            raise OSError(self.refuse[number], os.strerror(self.refuse[number]))
        answer = getattr(self, f"_{number}", None)
        if answer is None:
            raise OSError(errno.ENOTTY, "no such ioctl")
        answer(data)
        return 0

    def _0(self, data):  # QUERYCAP
        struct.pack_into(
            "16s32s32sIII", data, 0, b"uvcvideo", b"Test Cam", b"usb-1", 0, self.caps | 0x80000000, self.caps
        )

    def _2(self, data):  # ENUM_FMT
        (index,) = struct.unpack_from("I", data)
        struct.pack_into("4s", data, 44, _entry(list(self.formats), index).encode())

    def _74(self, data):  # ENUM_FRAMESIZES
        index, code = struct.unpack_from("I4s", data)
        if self.size_range:
            _entry([0], index)
            struct.pack_into("I6I", data, 8, 3, *self.size_range)
            return
        sizes = self.formats[code.decode()]
        if sizes is None:
            raise OSError(errno.ENOTTY, "no list")
        struct.pack_into("III", data, 8, 1, *_entry(list(sizes), index))

    def _75(self, data):  # ENUM_FRAMEINTERVALS
        index, code, width, height = struct.unpack_from("I4sII", data)
        if self.interval_range:
            _entry([0], index)
            struct.pack_into("I4I", data, 16, 2, *self.interval_range)
            return
        sizes = self.formats[code.decode()] or {}
        struct.pack_into("III", data, 16, 1, *_entry(sizes.get((width, height), []), index))

    def _5(self, data):  # S_FMT: behind the type, aligned as the union's pointers are
        at = struct.calcsize("I0P")
        width, height, code = struct.unpack_from("II4s", data, at)
        self.asked_format = (code.decode(), width, height)
        code, width, height = self.settle or self.asked_format
        struct.pack_into("II4sII", data, at, width, height, code.encode(), 1, self.stride)

    def _21(self, data):  # G_PARM
        struct.pack_into("III", data, 4, 0x1000, 0, 1)

    def _22(self, data):  # S_PARM
        self.asked_interval = struct.unpack_from("II", data, 12)

    def _8(self, data):  # REQBUFS
        (count,) = struct.unpack_from("I", data)
        self.buffers = [_Map(1 << 20) for _ in range(count)]

    def _9(self, data):  # QUERYBUF
        values = list(BUFFER.unpack(data))
        values[12], values[13] = values[0] * PAGE, 1 << 20
        BUFFER.pack_into(data, 0, *values)

    def _15(self, data):  # QBUF
        self.queued.append(struct.unpack_from("I", data)[0])
        if self.refill and not self.filled:
            self.expose(self.refill, 1.0)

    def _17(self, data):  # DQBUF
        if not self.filled:
            raise BlockingIOError(errno.EAGAIN, "nothing yet")
        os.read(self.fd, 1)
        index, used, stamp, flags = self.filled.pop(0)
        seconds = int(stamp)
        values = [
            index,
            1,
            used,
            flags,
            1,
            seconds,
            round((stamp - seconds) * 1e6),
            0,
            0,
            b"",
            0,
            1,
            index * PAGE,
            1 << 20,
        ]
        BUFFER.pack_into(data, 0, *values, 0, 0)

    def _18(self, data):  # STREAMON
        self.streaming = True

    def _19(self, data):  # STREAMOFF
        self.streaming = False

    def _36(self, data):  # QUERYCTRL
        number = struct.unpack_from("I", data)[0]
        if number not in self.controls:
            raise OSError(errno.EINVAL, "no such control")
        struct.pack_into("4i", data, 40, *self.controls[number][:4])

    def _27(self, data):  # G_CTRL
        struct.pack_into("i", data, 4, self.controls[struct.unpack_from("I", data)[0]][4])

    def _28(self, data):  # S_CTRL
        number, value = struct.unpack_from("Ii", data)
        low, high, *_ = self.controls[number]
        if not low <= value <= high:
            raise OSError(errno.ERANGE, "out of range")
        self.controls[number][4] = value


class _Map(bytearray):
    def __getitem__(self, key):
        """A copy, as mmap gives it."""
        return bytes(super().__getitem__(key))

    def close(self):
        """Nothing to let go of."""


def _entry(entries, index):
    if index >= len(entries):
        raise OSError(errno.EINVAL, "the end")
    return entries[index]
