"""The kernel's side of V4L2: the structures and request numbers of <linux/videodev2.h> that a webcam needs.

Laid out by ctypes as the C compiler would on this machine, so that 32-bit ones are right too: there a `long` in
`v4l2_buffer` has 4 bytes (32-bit time, which every kernel that Debian builds for i386 understands), and the request
numbers, which carry the sizes, differ with it.
"""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_long, c_uint8, c_uint32, c_ulong

CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MMAP = 1  # V4L2_MEMORY_MMAP
ANY_FIELD = 0  # V4L2_FIELD_ANY

CAP_VIDEO_CAPTURE, CAP_DEVICE_CAPS, CAP_STREAMING = 0x0000_0001, 0x8000_0000, 0x0400_0000
CAP_TIMEPERFRAME = 0x1000  # of captureparm.capability

DISCRETE = 1  # sizes and intervals one by one; 2 and 3 give a range

BUF_ERROR = 0x0040
BUF_CLOCK, BUF_CLOCK_MONOTONIC = 0xE000, 0x2000

CTRL_DISABLED, CTRL_READ_ONLY = 0x0001, 0x0004

_USER, _CAMERA = 0x0098_0900, 0x009A_0900
CID_AUTO_WHITE_BALANCE, CID_WHITE_BALANCE_TEMPERATURE = _USER + 12, _USER + 26
CID_EXPOSURE_AUTO, CID_EXPOSURE_ABSOLUTE, CID_EXPOSURE_AUTO_PRIORITY = _CAMERA + 1, _CAMERA + 2, _CAMERA + 3
# Values of CID_EXPOSURE_AUTO. "Aperture priority" is what webcams without an aperture call automatic.
EXPOSURE_AUTOMATIC, EXPOSURE_MANUAL, EXPOSURE_APERTURE_PRIORITY = 0, 1, 3


class Capability(ctypes.Structure):
    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FormatDescription(ctypes.Structure):
    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class Fraction(ctypes.Structure):
    _fields_ = (("numerator", c_uint32), ("denominator", c_uint32))


class SizeRange(ctypes.Structure):
    """Of a discrete size, the first two fields are width and height."""

    _fields_ = tuple((f"{what}_{side}", c_uint32) for side in ("width", "height") for what in ("min", "max", "step"))


class FrameSize(ctypes.Structure):
    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("range", SizeRange),
        ("reserved", c_uint32 * 2),
    )


class FrameInterval(ctypes.Structure):
    """Of a discrete interval, `shortest` is it."""

    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("type", c_uint32),
        ("shortest", Fraction),
        ("longest", Fraction),
        ("step", Fraction),
        ("reserved", c_uint32 * 2),
    )


class _Pixels(ctypes.Structure):
    _fields_ = tuple(
        (name, c_uint32)
        for name in (
            "width",
            "height",
            "pixelformat",
            "field",
            "bytesperline",
            "sizeimage",
            "colorspace",
            "priv",
            "flags",
            "ycbcr_enc",
            "quantization",
            "xfer_func",
        )
    )


class _FormatUnion(ctypes.Union):
    """`overlay` stands for the members with pointers, which align the union to 8 bytes on 64-bit machines."""

    _fields_ = (("pix", _Pixels), ("overlay", ctypes.c_void_p), ("raw", c_uint8 * 200))


class Format(ctypes.Structure):
    _anonymous_ = ("of",)
    _fields_ = (("type", c_uint32), ("of", _FormatUnion))


class CaptureParameters(ctypes.Structure):
    _fields_ = (
        ("type", c_uint32),
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fraction),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("rest", c_uint8 * (200 - 24)),
    )


class RequestBuffers(ctypes.Structure):
    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    )


class _TimeCode(ctypes.Structure):
    _fields_ = (("type", c_uint32), ("flags", c_uint32), ("rest", c_uint8 * 8))


class _BufferPlace(ctypes.Union):
    _fields_ = (("offset", c_uint32), ("userptr", c_ulong))


class Buffer(ctypes.Structure):
    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("seconds", c_long),
        ("microseconds", c_long),
        ("timecode", _TimeCode),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("place", _BufferPlace),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    )


class Control(ctypes.Structure):
    _fields_ = (("id", c_uint32), ("value", c_int32))


class ControlRange(ctypes.Structure):
    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default_value", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


_WRITE, _READ = 1, 2


def _request(direction: int, number: int, argument: type[ctypes._CData]) -> int:
    """_IOC of <asm-generic/ioctl.h>, as on x86, ARM and RISC-V."""
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord("V") << 8 | number


QUERYCAP = _request(_READ, 0, Capability)
ENUM_FMT = _request(_READ | _WRITE, 2, FormatDescription)
S_FMT = _request(_READ | _WRITE, 5, Format)
REQBUFS = _request(_READ | _WRITE, 8, RequestBuffers)
QUERYBUF = _request(_READ | _WRITE, 9, Buffer)
QBUF = _request(_READ | _WRITE, 15, Buffer)
DQBUF = _request(_READ | _WRITE, 17, Buffer)
STREAMON = _request(_WRITE, 18, c_int32)
STREAMOFF = _request(_WRITE, 19, c_int32)
G_PARM = _request(_READ | _WRITE, 21, CaptureParameters)
S_PARM = _request(_READ | _WRITE, 22, CaptureParameters)
G_CTRL = _request(_READ | _WRITE, 27, Control)
S_CTRL = _request(_READ | _WRITE, 28, Control)
QUERYCTRL = _request(_READ | _WRITE, 36, ControlRange)
ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, FrameSize)
ENUM_FRAMEINTERVALS = _request(_READ | _WRITE, 75, FrameInterval)


def fourcc(code: int) -> str:
    """MJPG and the like; a grey format's spaces at the end are kept."""
    return code.to_bytes(4, "little").decode("latin-1")


def code_of(name: str) -> int:
    """The number that `fourcc` calls so."""
    return int.from_bytes(name.encode("latin-1"), "little")
