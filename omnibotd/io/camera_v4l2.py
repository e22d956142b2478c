"""Frames of a camera on this machine: V4L2 through OpenCV, with JPEGs passed on as the camera made them."""

from __future__ import annotations

import os
import time
from collections.abc import Generator
from typing import Any

import cv2
import numpy as np

from omnibotd.core.vision.frame import Frame, Image
from omnibotd.io.camera_errors import CameraError

# Seconds OpenCV waits for a frame before `grab` fails; its own 10 s only keep a lost camera busy. Read at the
# first capture.
_SELECT_TIMEOUT = ("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "2")
# One buffer being filled while the other is read. With a single one, the camera has nowhere to put the frame
# that starts meanwhile, and the rate is halved; more would only hold older frames.
_BUFFERS = 2

_MJPG = cv2.VideoWriter.fourcc(*"MJPG")
_YUYV = cv2.VideoWriter.fourcc(*"YUYV")
_GREY = cv2.VideoWriter.fourcc(*"GREY")


def v4l2_frames(path: str, width: int, height: int, fps: float) -> Generator[Frame]:
    """Frames of the device `path`, JPEG bytes if it can, else grey or BGR pixels; ends by CameraError only."""
    _check(path)
    os.environ.setdefault(*_SELECT_TIMEOUT)
    # A name such as /dev/v4l/by-id/... is a link, which after a replug leads elsewhere.
    capture = cv2.VideoCapture(os.path.realpath(path), cv2.CAP_V4L2)
    try:
        if not capture.isOpened():
            raise CameraError(f"{path}: can't be opened; another program may be using it, or it is no camera")
        fourcc = _negotiate(capture, width, height, fps)
        while capture.grab():
            stamp = time.monotonic()
            good, raw = capture.retrieve()
            if good:
                yield Frame(stamp, _picture(np.asarray(raw), fourcc, capture))
        raise CameraError(f"{path}: the camera gives no more frames; it may have been unplugged")
    finally:
        capture.release()


def _check(path: str) -> None:
    if not os.path.exists(path):
        raise CameraError(f"{path}: no such device; is the camera plugged in?")
    if not os.access(path, os.R_OK | os.W_OK):
        raise CameraError(f"{path}: not permitted; this user must be in the group `video`")


def _negotiate(capture: Any, width: int, height: int, fps: float) -> int:
    """Ask for MJPG of the given size, undecoded; the format the camera settled on."""
    capture.set(cv2.CAP_PROP_FOURCC, _MJPG)
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
    capture.set(cv2.CAP_PROP_FPS, fps)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, _BUFFERS)
    fourcc = int(capture.get(cv2.CAP_PROP_FOURCC))
    # Other formats than these three OpenCV turns to BGR.
    capture.set(cv2.CAP_PROP_CONVERT_RGB, 0 if fourcc in (_MJPG, _YUYV, _GREY) else 1)
    return fourcc


def _picture(raw: np.ndarray[Any, Any], fourcc: int, capture: Any) -> bytes | Image:
    """The frame in `raw`, whose shape differs between releases of OpenCV but whose bytes do not.

    An MJPG frame comes as (1, N) or (N, 1) bytes, in some releases with the rest of the buffer behind the
    picture; YUYV as (H, W, 2), flat in 4.11. A frame too short for its size is passed as bytes, which are
    refused as no JPEG.
    """
    if fourcc == _MJPG:
        return raw.tobytes()
    width, height = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    depth = {_YUYV: 2, _GREY: 1}.get(fourcc, 3)
    if raw.size < width * height * depth:
        return raw.tobytes()
    pixels = raw.reshape(-1)[: width * height * depth].reshape(height, width, depth)
    return np.array(pixels if depth == 3 else pixels[..., 0], np.uint8)
