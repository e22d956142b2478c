"""A camera that was not mounted as it should have been: tilted, its optical centre shifted, off the axle's middle."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Image

TILT = (math.radians(1.2), math.radians(0.9))  # about the direction of the image's top, and of the one left of it
SHIFT = (3.0, -2.0)  # px by which the optical centre lies right of and below the image circle's
OFFSET = (0.016, -0.012)  # m ahead and to the left of the axle's middle: 2 cm
_TAPER = 8.0  # px at the rim over which the shift ends: beyond the image circle there is nothing to shift in
_MARGIN = math.radians(6.0)  # more than tilt and shift together move a ray


def tilted(lens: CameraModel) -> CameraModel:
    """What a calibration of the tilted camera should find."""
    return replace(lens, tilt=TILT, cx=lens.cx + SHIFT[0], cy=lens.cy + SHIFT[1])


class Tilted:
    """Re-projects pictures of a level camera to what the tilted one sees; the image circle stays where it is."""

    def __init__(self, lens: CameraModel) -> None:
        pixels = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), -1).astype(float)
        wide = replace(lens, fov=min(lens.fov + 2.0 * _MARGIN, 2.0 * math.pi))
        shift = np.nan_to_num(wide.project(tilted(wide).unproject(pixels)) - pixels)
        radius = np.hypot((pixels[..., 0] - lens.cx) / lens.fx, (pixels[..., 1] - lens.cy) / lens.fy)
        left = (lens.fov / 2.0 - radius) * lens.fx / _TAPER
        # Both maps float32: OpenCV 5 returns garbage, silently, when one is float64.
        maps = (pixels + shift * np.clip(left, 0.0, 1.0)[..., None]).astype(np.float32)
        self._maps = cv2.convertMaps(maps[..., 0].copy(), maps[..., 1].copy(), cv2.CV_16SC2)

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image:
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR), np.uint8)


def off_the_axle(x: float, y: float, yaw: float) -> tuple[float, float]:
    """Where the camera is when the axle's middle is at (x, y)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * OFFSET[0] - s * OFFSET[1], y + s * OFFSET[0] + c * OFFSET[1]
