"""Heading from a red and a blue tile on the ceiling (thesis §2.4.1 and §6.5.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import FrameError
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image

WIDTH, HEIGHT = 640, 480
# px, [assumed]: 152 x 143 degrees, of which the perception's disc holds 136. The tops of the walls tell a ceiling's
# repetitions apart: at 140 px a perception is twice as often taken for another place's, at 70 px the tiles get small.
FOCAL = 80.0
# Of an opposing channel's 255, [assumed], set by hand as in the thesis: books reach 80, the paint of a lit tile 170.
THRESHOLD = 90.0
# px, [assumed]: noise makes smaller blobs, a tile of 0.35 m at 2.2 m makes 160.
MIN_AREA = 40

BLUE, GREEN, RED = 0, 1, 2


class Undistortion:
    """The fisheye's picture as a perspective one, 640 x 480, levelled, its top towards the robot's front."""

    def __init__(self, camera: CameraModel) -> None:
        u = (np.arange(WIDTH) - (WIDTH - 1) / 2.0) / FOCAL
        v = (np.arange(HEIGHT) - (HEIGHT - 1) / 2.0) / FOCAL
        left, back = np.meshgrid(u, v)
        # Outside the lens the border's black; both maps float32, or OpenCV 5 returns garbage.
        pixels = np.nan_to_num(camera.project(np.stack([-back, left, np.ones_like(left)], -1)), nan=-2.0)
        where = pixels.astype(np.float32)
        self._maps = cv2.convertMaps(where[..., 0].copy(), where[..., 1].copy(), cv2.CV_16SC2)
        self._shape = (camera.height, camera.width)

    def __call__(self, frame: Frame) -> Image:
        """(480, 640, 3) BGR. FrameError where the frame can't be decoded or has another size than the camera."""
        image = decode_colour(frame)
        if image.shape[:2] != self._shape:
            wanted, got = (f"{shape[1]}x{shape[0]}" for shape in (self._shape, image.shape))
            raise FrameError(f"frame is {got}, the calibration is for {wanted}: calibrate at this size")
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR), np.uint8)


def decode_colour(frame: Frame) -> Image:
    """(H, W, 3) BGR pixels of a frame; a grey one has three equal channels. FrameError where it is no picture."""
    if not isinstance(frame.data, bytes):
        grey = frame.data.ndim == 2
        return np.asarray(cv2.cvtColor(frame.data, cv2.COLOR_GRAY2BGR) if grey else frame.data, np.uint8)
    try:
        image = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise FrameError(f"frame can't be decoded: {error}") from error
    if image is None:
        raise FrameError(f"frame of {len(frame.data)} bytes is no picture that OpenCV can decode")
    return np.asarray(image, np.uint8)


def opposing(image: Image, channel: int) -> NDArray[np.int16]:
    """Twice the opposing channel (Eqs 2.3-2.5), so that it stays whole: 2c - (a + b), from -510 to 510."""
    channels = cv2.split(image)
    # In signed numbers: bytes would wrap.
    apart = [cv2.subtract(channels[channel], other, dtype=cv2.CV_16S) for other in channels]
    return np.asarray(cv2.add(cv2.add(apart[0], apart[1]), apart[2]), np.int16)


def blobs(image: Image, channel: int, least: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Mean pixels (n, 2) and areas (n,) of the connected areas of this colour that have `least` pixels or more."""
    mask = (opposing(image, channel) > 2.0 * THRESHOLD).astype(np.uint8)
    _, _, stats, centres = cv2.connectedComponentsWithStats(mask)
    areas = stats[:, cv2.CC_STAT_AREA]
    large = np.flatnonzero(areas >= least)
    large = large[large > 0]  # 0 is all that isn't of this colour
    return np.asarray(centres[large], np.float64), np.asarray(areas[large], np.int32)


def largest_blob(image: Image, channel: int) -> tuple[float, float] | None:
    """Mean pixel (u, v) of the largest connected area of this colour, None where there is none."""
    centres, areas = blobs(image, channel, MIN_AREA)
    if not len(areas):
        return None
    u, v = (float(value) for value in centres[np.argmax(areas)])
    return u, v


def heading(image: Image) -> float | None:
    """Eq 6.8 as the robot's heading in compass axes, counter-clockwise; None where a tile is not seen.

    theta is the image's angle of the line from blue to red. Turning the content by pi/2 - theta puts red straight
    below blue, which is what a robot of heading 0 sees: x of the compass axes points from the red tile to the blue.
    """
    red, blue = largest_blob(image, RED), largest_blob(image, BLUE)
    if red is None or blue is None:
        return None
    theta = math.atan2(red[1] - blue[1], red[0] - blue[0])
    return wrap(math.pi / 2.0 - theta)


@dataclass(frozen=True, slots=True)
class Heading:
    """Radians in compass axes; `seen` is False where it was carried on by odometry."""

    yaw: float
    seen: bool


class Compass:
    """The tiles' heading; while one is hidden, the last heading and what odometry turned since [assumed]."""

    def __init__(self) -> None:
        self._axes_from_odom: float | None = None

    def read(self, image: Image, odom_from_base: Pose2D) -> Heading | None:
        """From an undistorted image; None before the tiles were first seen."""
        yaw = heading(image)
        if yaw is not None:
            self._axes_from_odom = wrap(yaw - odom_from_base.yaw)
            return Heading(yaw, True)
        if self._axes_from_odom is None:
            return None
        return Heading(wrap(self._axes_from_odom + odom_from_base.yaw), False)
