"""A picture in which bearings are directions from a centre: what a conical mirror shows, or a levelled fisheye.

All compasses of the thesis work on it, in pixels or unrolled into a panorama.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.rectification import Lookup
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import FloatImage, Frame, Image

Floats = NDArray[np.float64]

# Of a levelled fisheye: the zenith has no bearing, and what is lower than the horizon is mostly the robot's own floor.
_NEAREST, _FARTHEST = math.radians(5.0), math.radians(85.0)


@dataclass(frozen=True, slots=True)
class Ring:
    """Where bearings are in a picture: bearing b (CCW from the robot's front) at image angle front + sense * b.

    Image angles turn from right to down. Only what lies between the radii `inner` and `outer` (px) is looked at.
    """

    u: float
    v: float
    inner: float
    outer: float
    front: float = 0.0
    sense: int = 1

    def bearings(self, u: Floats, v: Floats) -> Floats:
        """Of pixels, in [-pi, pi]."""
        angle = self.sense * (np.arctan2(v - self.v, u - self.u) - self.front)
        return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))

    def pixels(self, bearings: Floats) -> tuple[FloatImage, FloatImage]:
        """Columns and rows (radii, bearings) of radial lines, a pixel apart along each from `inner` to `outer`."""
        radius = np.arange(self.inner, self.outer)[:, None]
        angle = self.front + self.sense * bearings
        # Both maps float32: OpenCV 5 returns garbage, silently, when one is float64.
        return (self.u + radius * np.cos(angle)).astype(np.float32), (self.v + radius * np.sin(angle)).astype(
            np.float32
        )


@dataclass(frozen=True, slots=True, eq=False)
class RoundView:
    """One picture (H, W) grey and where bearings are in it."""

    grey: Image
    ring: Ring

    def unrolled(self, first: float, step: float, count: int) -> FloatImage:
        """(radii, count) brightness along the radial lines at bearings first + k * step (rad), bilinear."""
        places = self.ring.pixels(np.asarray(first + step * np.arange(count), np.float64))
        # In float: OpenCV's interpolation of bytes knows only 32nds of a pixel.
        return np.asarray(cv2.remap(self.grey.astype(np.float32), *places, cv2.INTER_LINEAR), np.float32)


class Levelling:
    """Turns the frames of a fisheye into round views: radius = focal * zenith angle, whatever tilt and lens."""

    def __init__(self, camera: CameraModel, reduction: int = 1) -> None:
        """`reduction` in {1, 2, 4, 8}: how many times smaller than its frames the view is."""
        self._reduction = reduction
        small = camera.reduced(reduction)
        focal, half = small.fx, min(_FARTHEST, camera.fov / 2.0)
        reach = math.ceil(focal * half) + 2
        v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float64)
        zenith, bearing = np.hypot(u, v) / focal, np.arctan2(v, u)
        across = np.sin(zenith)
        self._lookup = Lookup(small, np.stack([across * np.cos(bearing), across * np.sin(bearing), np.cos(zenith)], -1))
        self.seen = self._lookup.valid  # 255 where the camera sees anything
        self.ring = Ring(reach, reach, focal * _NEAREST, focal * half)

    def __call__(self, frame: Frame) -> RoundView:
        """Raises FrameError where the frame is no picture, or not of the camera's size."""
        return RoundView(self._lookup(frame.grey(self._reduction)), self.ring)
