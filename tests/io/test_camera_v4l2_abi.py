"""Sizes, offsets and request numbers against the C compiler and the kernel's own header, as 64 and as 32 bits."""

import ctypes
import importlib.util
import json
import shutil
import subprocess
import sys

import pytest

from omnibotd.io import camera_v4l2_abi

HEADER = "linux/videodev2.h"
STRUCTS = {  # ours: (the header's, {our field: its field})
    "Capability": ("v4l2_capability", {"card": "card", "capabilities": "capabilities", "device_caps": "device_caps"}),
    "FormatDescription": ("v4l2_fmtdesc", {"index": "index", "type": "type", "pixelformat": "pixelformat"}),
    "FrameSize": ("v4l2_frmsizeenum", {"pixel_format": "pixel_format", "type": "type", "range": "stepwise"}),
    "SizeRange": (
        "v4l2_frmsize_stepwise",
        {name: name for name in ("min_width", "max_width", "step_width", "min_height", "max_height", "step_height")},
    ),
    "FrameInterval": (
        "v4l2_frmivalenum",
        {"width": "width", "type": "type", "shortest": "stepwise.min", "longest": "stepwise.max"},
    ),
    "Format": ("v4l2_format", {"type": "type", "pix": "fmt.pix"}),
    "CaptureParameters": (
        "v4l2_streamparm",
        {"type": "type", "capability": "parm.capture.capability", "timeperframe": "parm.capture.timeperframe"},
    ),
    "RequestBuffers": ("v4l2_requestbuffers", {"count": "count", "type": "type", "memory": "memory"}),
    "Buffer": (
        "v4l2_buffer",
        {
            "index": "index",
            "bytesused": "bytesused",
            "flags": "flags",
            "seconds": "timestamp.tv_sec",
            "microseconds": "timestamp.tv_usec",
            "sequence": "sequence",
            "memory": "memory",
            "place": "m.offset",
            "length": "length",
        },
    ),
    "Control": ("v4l2_control", {"id": "id", "value": "value"}),
    "ControlRange": ("v4l2_queryctrl", {"minimum": "minimum", "default_value": "default_value", "flags": "flags"}),
}
NUMBERS = {
    **{
        name: f"VIDIOC_{name}"
        for name in [
            "QUERYCAP",
            "ENUM_FMT",
            "S_FMT",
            "REQBUFS",
            "QUERYBUF",
            "QBUF",
            "DQBUF",
            "STREAMON",
            "STREAMOFF",
            "G_PARM",
            "S_PARM",
            "G_CTRL",
            "S_CTRL",
            "QUERYCTRL",
            "ENUM_FRAMESIZES",
            "ENUM_FRAMEINTERVALS",
        ]
    },
    **{
        name: f"V4L2_{name}"
        for name in [
            "CAP_VIDEO_CAPTURE",
            "CAP_DEVICE_CAPS",
            "CAP_STREAMING",
            "CAP_TIMEPERFRAME",
            "CID_AUTO_WHITE_BALANCE",
            "CID_WHITE_BALANCE_TEMPERATURE",
            "CID_EXPOSURE_AUTO",
            "CID_EXPOSURE_ABSOLUTE",
            "CID_EXPOSURE_AUTO_PRIORITY",
            "EXPOSURE_MANUAL",
            "EXPOSURE_APERTURE_PRIORITY",
        ]
    },
    "CAPTURE": "V4L2_BUF_TYPE_VIDEO_CAPTURE",
    "MMAP": "V4L2_MEMORY_MMAP",
    "DISCRETE": "V4L2_FRMSIZE_TYPE_DISCRETE",
    "BUF_ERROR": "V4L2_BUF_FLAG_ERROR",
    "BUF_CLOCK": "V4L2_BUF_FLAG_TIMESTAMP_MASK",
    "BUF_CLOCK_MONOTONIC": "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC",
    "CTRL_DISABLED": "V4L2_CTRL_FLAG_DISABLED",
    "CTRL_READ_ONLY": "V4L2_CTRL_FLAG_READ_ONLY",
    "EXPOSURE_AUTOMATIC": "V4L2_EXPOSURE_AUTO",
}


def by_compiler(tmp_path, bits: int) -> dict[str, int]:
    """What the C compiler makes of the header; skips the test where it can't."""
    facts = {ours: f"sizeof(struct {theirs})" for ours, (theirs, _) in STRUCTS.items()}
    for ours, (theirs, fields) in STRUCTS.items():
        facts |= {f"{ours}.{name}": f"offsetof(struct {theirs}, {field})" for name, field in fields.items()}
    facts |= NUMBERS
    lines = [f'printf("\\"{name}\\": %lu,\\n", (unsigned long)({value}));' for name, value in facts.items()]
    source = f"#include <stddef.h>\n#include <stdio.h>\n#include <{HEADER}>\nint main(void) {{ {''.join(lines)} }}"
    (tmp_path / "facts.c").write_text(source)
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: apt-get install gcc linux-libc-dev")
    command = [compiler, f"-m{bits}", str(tmp_path / "facts.c"), "-o", str(tmp_path / "facts")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"no C compiler for {bits} bits: apt-get install gcc-multilib; {done.stderr.splitlines()[0]}")
    told = subprocess.run([str(tmp_path / "facts")], capture_output=True, text=True, check=True).stdout
    return json.loads("{" + told.rstrip().rstrip(",") + "}")


def by_us(module) -> dict[str, int]:
    facts = {name: getattr(module, name) for name in NUMBERS}
    for ours, (_, fields) in STRUCTS.items():
        struct = getattr(module, ours)
        facts[ours] = ctypes.sizeof(struct)
        facts |= {f"{ours}.{name}": getattr(struct, name).offset for name in fields}
    return facts


def as_32_bits(monkeypatch):
    """The module as an i386 Python would load it, where a long and a pointer have 4 bytes."""
    for name, small in (("c_long", ctypes.c_int32), ("c_ulong", ctypes.c_uint32), ("c_void_p", ctypes.c_uint32)):
        monkeypatch.setattr(ctypes, name, small)
    spec = importlib.util.spec_from_file_location("abi32", camera_v4l2_abi.__file__)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_layout_is_the_compilers(tmp_path):
    assert by_us(camera_v4l2_abi) == by_compiler(tmp_path, 64 if sys.maxsize > 2**32 else 32)


def test_on_32_bits_too(tmp_path, monkeypatch):
    theirs = by_compiler(tmp_path, 32)
    assert by_us(as_32_bits(monkeypatch)) == theirs
    assert theirs["Buffer"] == 68  # with 32-bit time: what i386 kernels and programs have always spoken


def test_sizes_are_what_the_kernel_has_had_for_years():
    """Where there is no compiler: 64-bit sizes by hand from the header."""
    if sys.maxsize < 2**32:
        pytest.skip("this Python has 32 bits")
    assert ctypes.sizeof(camera_v4l2_abi.Format) == 208
    assert ctypes.sizeof(camera_v4l2_abi.Buffer) == 88
    assert ctypes.sizeof(camera_v4l2_abi.CaptureParameters) == 204


def test_fourccs_go_both_ways():
    assert camera_v4l2_abi.fourcc(0x47504A4D) == "MJPG"
    assert camera_v4l2_abi.code_of("MJPG") == 0x47504A4D
