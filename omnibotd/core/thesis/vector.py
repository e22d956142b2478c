"""The perception vector: 7986 gradient magnitudes on circles, turned to the compass axes (thesis §6.5.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.thesis.compass import Compass, Heading, Undistortion
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image

Floats = NDArray[np.float32]

WIDTH, HEIGHT = 160, 120
RADIUS = 50  # px; circle r carries floor(2 pi r) samples, the centre none: 7986 in all


def _circles() -> Floats:
    """(2, 7986) offsets (u, v) from the image's centre, inner circles first, each begun towards +u [assumed]."""
    rings = []
    for radius in range(1, RADIUS + 1):
        count = math.floor(2.0 * math.pi * radius)
        angle = np.arange(count) * (2.0 * math.pi / count)
        rings.append(radius * np.stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(rings, axis=1).astype(np.float32)


_OFFSETS = _circles()
LENGTH = _OFFSETS.shape[1]


def gradient_magnitude(image: Image) -> Floats:
    """(120, 160) Eq 6.9, unnormalised Sobel, of an undistorted BGR image."""
    small = cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    fx, fy = cv2.Sobel(small, cv2.CV_32F, 1, 0), cv2.Sobel(small, cv2.CV_32F, 0, 1)
    return np.asarray(cv2.magnitude(fx, fy), np.float32)


def sample_circles(magnitude: Floats, yaw: float) -> Floats:
    """(7986,) samples as if the image's content had been turned by the heading `yaw`.

    The gradient's magnitude does not turn with the axes it is taken in, so only the sampling is turned [assumed].
    """
    c, s = math.cos(yaw), math.sin(yaw)
    turn_back = np.array([[c, s], [-s, c]], np.float32)
    u, v = turn_back @ _OFFSETS
    columns, rows = u + np.float32((WIDTH - 1) / 2.0), v + np.float32((HEIGHT - 1) / 2.0)
    sampled = cv2.remap(magnitude, columns.reshape(-1, 1), rows.reshape(-1, 1), cv2.INTER_LINEAR)
    return np.asarray(sampled.ravel(), np.float32)


@dataclass(frozen=True)
class Perception:
    """What one frame says: the robot's heading and the vector (7986,) in compass axes."""

    heading: Heading
    vector: Floats


class Perceiver:
    """From a frame to its perception; carries the compass from frame to frame."""

    def __init__(self, camera: CameraModel) -> None:
        self._undistortion = Undistortion(camera)
        self._compass = Compass()

    def reset(self) -> None:
        """Forget the heading."""
        self._compass = Compass()

    def perceive(self, frame: Frame, odom_from_base: Pose2D) -> Perception | None:
        """None before the tiles were first seen. FrameError where the frame can't be used."""
        image = self._undistortion(frame)
        heading = self._compass.read(image, odom_from_base)
        if heading is None:
            return None
        return Perception(heading, sample_circles(gradient_magnitude(image), heading.yaw))
