"""People who walk about a room: dark silhouettes before walls and part of the ceiling."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Image

FLOOR_EACH = 9.0  # m2 a person: four in a room of 6 x 6 m
NEAREST = 0.7  # m: people make way for a robot
FARTHEST = 5.0  # m; beyond it a person hides nothing that matters
CAMERA = 0.5  # m above the floor; a world does not say, and this is where the thesis has it
PACE = 0.4  # m/s at most: a stroll, as long as somebody talks
FROM_WALL = 0.4  # m
_SUBPIXEL = 4  # bits
# Half the width (m) at heights (m) above the floor, from the hips to a head 1.7 m up.
_BODY = ((0.17, 0.45), (0.18, 0.6), (0.19, 0.75), (0.21, 0.95), (0.18, 1.15), (0.23, 1.35), (0.20, 1.43))
_HEAD = ((0.07, 1.48), (0.09, 1.55), (0.09, 1.63), (0.04, 1.70))
_OUTLINE = np.array(_BODY + _HEAD)
_SHAPE = np.vstack([_OUTLINE * (-1.0, 1.0), _OUTLINE[::-1]])

Floats = NDArray[np.float64]


class People:
    """Each walks a loop of their own round the room, the same for the same seed and time."""

    def __init__(self, lens: CameraModel, bounds: tuple[float, float, float, float], seed: int) -> None:
        self._lens = lens
        low, high = np.array(bounds[:2]), np.array(bounds[2:])
        count = max(1, round(float(np.prod(high - low)) / FLOOR_EACH))
        rng = np.random.default_rng((seed, 7502))
        self._centre = (low + high) / 2.0
        self._reach = np.maximum((high - low) / 2.0 - FROM_WALL, 0.1)
        # Both components at full speed at once make a diagonal.
        self._rates = PACE / math.sqrt(2.0) / self._reach * rng.uniform(0.5, 1.0, (count, 2))
        self._phases = rng.uniform(-math.pi, math.pi, (count, 2))
        self._clothes = [tuple(int(c) for c in rng.integers(15, 55, 3)) for _ in range(count)]

    def positions(self, t: float) -> Floats:
        """(n, 2) at t seconds, in the world."""
        return np.asarray(self._centre + self._reach * np.sin(self._rates * t + self._phases))

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image:
        image = image.copy()
        for (px, py), clothes in zip(self.positions(t), self._clothes, strict=True):
            distance = max(math.hypot(px - x, py - y), NEAREST)
            if distance <= FARTHEST:
                self._draw(image, distance, math.atan2(py - y, px - x) - yaw, clothes)
        return image

    def _draw(self, image: Image, distance: float, bearing: float, clothes: tuple[int, ...]) -> None:
        cos, sin = math.cos(bearing), math.sin(bearing)
        aside, up = _SHAPE[:, 0], _SHAPE[:, 1] - CAMERA
        rays = np.column_stack([distance * cos - aside * sin, distance * sin + aside * cos, up])
        outline = self._lens.project(rays)
        outline = outline[np.isfinite(outline).all(axis=1)]
        if len(outline) >= 3:
            points = np.rint(outline * 2**_SUBPIXEL).astype(np.int32)
            cv2.fillPoly(image, [points], clothes, cv2.LINE_AA, _SUBPIXEL)
