"""A floor that slopes: the camera leans one way in the world, hence another in the robot's axes at every heading."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Image

ANGLE, GENTLE = math.radians(1.0), math.radians(0.2)
_TAPER = 4.0  # px at the rim over which the shift ends: beyond the image circle there is nothing to shift in

Floats = NDArray[np.float32]


class Slope:
    """Re-projects pictures through the lens; the seed says which way is down.

    The shift of each pixel is linear in the leaning to 0.02 px at one degree, so two fields, one for each axis of the
    robot, serve every heading. The camera's height above a long slope is left as it is.
    """

    def __init__(self, lens: CameraModel, seed: int, angle: float = ANGLE) -> None:
        self._toward = float(np.random.default_rng((seed, 7501)).uniform(-math.pi, math.pi))
        pixels = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), -1)
        self._at = pixels.astype(np.float32)
        self._ahead = _shift(lens, pixels, (0.0, angle))
        self._left = _shift(lens, pixels, (-angle, 0.0))

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image:
        toward = self._toward - yaw
        maps = self._at + np.float32(math.cos(toward)) * self._ahead + np.float32(math.sin(toward)) * self._left
        return np.asarray(cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR), np.uint8)


def _shift(lens: CameraModel, pixels: NDArray[np.int64], leaning: tuple[float, float]) -> Floats:
    """(H, W, 2) pixels from what a leaning camera sees to where a level one sees it; `leaning` about x and y."""
    rays = lens.unproject(pixels)
    wide = replace(lens, fov=lens.fov + 4.0 * ANGLE)  # the greater of both angles serves both
    turn, _ = cv2.Rodrigues(np.array([*leaning, 0.0]))
    # A central difference: what is left out is of third order.
    shift = np.nan_to_num((wide.project(rays @ turn.T) - wide.project(rays @ turn)) / 2.0)
    radius = np.hypot((pixels[..., 0] - lens.cx) / lens.fx, (pixels[..., 1] - lens.cy) / lens.fy) * lens.fx
    rim = np.max(radius, where=np.isfinite(rays[..., 0]), initial=0.0)
    return np.asarray(shift * np.clip((rim - radius) / _TAPER, 0.0, 1.0)[..., None], np.float32)
