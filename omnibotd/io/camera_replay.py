"""Frames of a recording: a folder of images or a video file."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

from omnibotd.core.vision.frame import Frame
from omnibotd.io.camera_errors import CameraError

_JPEG = (".jpg", ".jpeg")
_OTHER_IMAGES = (".png", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp")


def frames_of(path: Path, fps: float = 15.0) -> Generator[Frame]:
    """Frames of the recording at `path` as fast as they can be read; raises CameraError where there are none.

    They are stamped from 0 on: in a folder in steps of 1/fps, in order of name; in a video as it says itself.
    """
    if not path.exists():
        raise CameraError(f"{path}: no such file or folder")
    yield from _folder(path, fps) if path.is_dir() else _video(path, fps)


def paced(path: Path, fps: float) -> Generator[Frame]:
    """Frames of the recording at the pace it was made, stamped with the monotonic time at which they come."""
    start = time.monotonic()
    with closing(frames_of(path, fps)) as frames:
        for frame in frames:
            time.sleep(max(0.0, start + frame.stamp - time.monotonic()))
            yield Frame(time.monotonic(), frame.data)


def _folder(path: Path, fps: float) -> Iterator[Frame]:
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in _JPEG + _OTHER_IMAGES)
    if not files:
        raise CameraError(f"{path}: no images in this folder")
    for index, file in enumerate(files):
        yield Frame(index / fps, _image(file))


def _image(file: Path) -> bytes | np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """A JPEG's bytes as they are; other formats as pixels, or as bytes where OpenCV can't read them.

    Such a frame is refused by whoever looks at it, as a broken JPEG is.
    """
    data = file.read_bytes()
    if file.suffix.lower() in _JPEG:
        return data
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    return data if pixels is None else np.asarray(pixels, np.uint8)


def _video(path: Path, fps: float) -> Iterator[Frame]:
    capture = cv2.VideoCapture(str(path))
    try:
        own = capture.get(cv2.CAP_PROP_FPS)
        step = 1.0 / (own if 0.0 < own < 1000.0 else fps)  # OpenCV says 0 or 90000 where the file doesn't tell
        count = 0
        while True:
            good, pixels = capture.read()
            if not good:
                break
            yield Frame(count * step, np.asarray(pixels, np.uint8))
            count += 1
        if count == 0:
            raise CameraError(f"{path}: OpenCV finds no video in it")
    finally:
        capture.release()
