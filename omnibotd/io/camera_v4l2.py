"""Frames of a camera on this machine, by V4L2: JPEGs passed on as the camera made them, of others the brightness."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing

import numpy as np

from omnibotd.core.vision.frame import Frame, Image
from omnibotd.io.camera_errors import CameraError
from omnibotd.io.camera_v4l2_device import Device, Layout
from omnibotd.io.camera_v4l2_lock import lock_exposure, lock_white_balance
from omnibotd.io.camera_v4l2_modes import Stream, Wanted, best, differences

# s to the first frame, and between two: the camera is given up about when whoever waits for frames gives up, too,
# so that it is free again when it is opened anew.
FIRST_FRAME, NEXT_FRAME = 5.0, 1.0
# A driver's stamp further from now than this is no time of arrival: some cameras' own clocks run wild.
PLAUSIBLE = 1.0  # s

# Bytes from pixel to pixel and the first one's offset where brightness is not a plane of its own.
_INTERLEAVED = {"YUYV": (2, 0), "UYVY": (2, 1)}

_REASONS = {
    errno.ENOENT: "no such device; is the camera plugged in?",
    errno.ENXIO: "no such device; is the camera plugged in?",
    errno.EACCES: "not permitted; this user must be in the group `video`",
    errno.EPERM: "not permitted; this user must be in the group `video`, and the service allowed to use the device",
    errno.EBUSY: "another program is using it",
    errno.ENODEV: "the camera was unplugged",
    errno.ENOSPC: "the USB bus has no room for this stream; unplug other devices or ask for a smaller picture",
}


def v4l2_frames(path: str, wanted: Wanted, tell: Callable[[Stream], None]) -> Generator[Frame]:
    """Frames of the device `path`, JPEG bytes if it can, else grey; `tell` what was settled on. Ends by CameraError."""
    try:
        with closing(Device(path)) as device:
            layout = _settle(device, path, wanted, tell)
            yield from _frames(device, layout)
    except OSError as error:
        raise CameraError(f"{path}: {_REASONS.get(error.errno or 0) or error.strerror or error}") from error
    raise CameraError(f"{path}: the camera gives no more frames")


def _settle(device: Device, path: str, wanted: Wanted, tell: Callable[[Stream], None]) -> Layout:
    """Choose, start, lock: some cameras forget what they were told before their stream began."""
    mode = best(device.modes(wanted), wanted)
    if mode is None:
        raise CameraError(
            f"{path}: {device.card} offers {', '.join(device.formats()) or 'no format'}, none we can read"
        )
    layout, mode = device.use(mode)
    device.start()
    exposure, too_long = lock_exposure(device, wanted.exposure)
    white_balance, too_far = lock_white_balance(device, wanted.white_balance)
    warnings = (*differences(mode, wanted), too_long, too_far)
    tell(Stream(device.card, mode, exposure, white_balance, tuple(filter(None, warnings))))
    return layout


def _frames(device: Device, layout: Layout) -> Iterator[Frame]:
    """Until the camera falls silent."""
    timeout, last = FIRST_FRAME, 0.0
    while (shot := device.newest(timeout)) is not None:
        last = _stamp(shot.stamp, time.monotonic(), last)
        yield Frame(last, b"" if shot.damaged else _picture(shot.data, layout))
        timeout = NEXT_FRAME


def _stamp(told: float | None, now: float, last: float) -> float:
    """The driver's where that can be true: in the recent past and after the last; else the moment of arrival."""
    return told if told is not None and max(last, now - PLAUSIBLE) < told <= now else now


def _picture(data: bytes, layout: Layout) -> bytes | Image:
    """A JPEG as it is, else grey pixels (height, width). A buffer too short is passed on, to be refused as no JPEG."""
    if layout.fourcc in ("MJPG", "JPEG"):
        return data
    step, offset = _INTERLEAVED.get(layout.fourcc, (1, 0))
    stride = max(layout.stride, step * layout.width)
    if len(data) < stride * layout.height:
        return data
    lines = np.frombuffer(data, np.uint8, stride * layout.height).reshape(layout.height, stride)
    return np.array(lines[:, offset : step * layout.width : step])
