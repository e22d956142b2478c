"""Perspective view of the ceiling: the central field of view of the fisheye, levelled and turned to the base's axes."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import FrameError
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Image


class Lookup:
    """Samples a grey image along rays given in the base frame; the table is computed once."""

    def __init__(self, camera: CameraModel, rays: NDArray[np.float64]) -> None:
        """`rays` (rows, columns, 3), of any length, in the base frame."""
        pixels = camera.project(rays)
        self._shape = (camera.height, camera.width)
        edge = np.array([camera.width - 1.0, camera.height - 1.0])
        seen = np.asarray(np.all(np.isfinite(pixels) & (pixels >= 0.0) & (pixels <= edge), axis=-1))
        self.valid: Image = np.where(seen, 255, 0).astype(np.uint8)
        # Both maps float32: OpenCV 5 returns garbage, silently, when one is float64.
        where = np.where(seen[..., None], pixels, -1.0).astype(np.float32)
        self._maps = cv2.convertMaps(where[..., 0].copy(), where[..., 1].copy(), cv2.CV_16SC2)

    def __call__(self, grey: Image) -> Image:
        """uint8 (rows, columns), 0 where the camera sees nothing. Raises FrameError on an image of another size."""
        if grey.shape != self._shape:
            wanted, got = (f"{shape[1]}x{shape[0]}" for shape in (self._shape, grey.shape))
            raise FrameError(f"frame is {got}, the calibration is for {wanted}: calibrate at this size")
        return np.asarray(cv2.remap(grey, *self._maps, cv2.INTER_LINEAR), np.uint8)


class Rectification(Lookup):
    """size x size view of the ceiling plane over `fov` radians: column grows to the robot's left, row to its back.

    A point of the ceiling at (x, y) times its height stands at column c + focal * y, row c - focal * x, where
    c = (size - 1) / 2.
    """

    def __init__(self, camera: CameraModel, size: int, fov: float) -> None:
        self.size = size
        self.focal = size / 2.0 / math.tan(fov / 2.0)
        super().__init__(camera, ceiling_rays(size, fov))


def ceiling_rays(size: int, fov: float) -> NDArray[np.float64]:
    """Rays (size, size, 3) of the pixels of such a view."""
    step = (np.arange(size) - (size - 1) / 2.0) * (2.0 * math.tan(fov / 2.0) / size)
    y, minus_x = np.meshgrid(step, step)
    return np.stack([-minus_x, y, np.ones_like(y)], -1)


def rim_rays(zeniths: NDArray[np.float64], bearings: int) -> NDArray[np.float64]:
    """Rays (len(zeniths), bearings, 3) of circles about the vertical; the angle turns from column to row of a view."""
    angle = np.arange(bearings) * (2.0 * math.pi / bearings)
    angle, zenith = np.meshgrid(angle, zeniths)
    across = np.sin(zenith)
    return np.stack([-np.sin(angle) * across, np.cos(angle) * across, np.cos(zenith)], -1)
