"""A lens out of focus, and one that is partly covered: dirt, drops, a label."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Image

BLUR = 1.2  # px, standard deviation: a webcam lens a quarter of a turn out of focus
NOISE = 1.75  # grey values that a blur of 1.2 px takes from the 1.8 of the sensor
_POOL = 64  # px of shift that the noise pool allows
COVERED = 0.10  # share of the image circle
MOST_PATCHES = 3
_EDGE = 4.0  # px: what lies on the lens is far out of focus


class Blur:
    """Out of focus, evenly; the sensor's noise, which the blurring takes out with the rest, comes back."""

    def __init__(self, lens: CameraModel, seed: int) -> None:
        rng = np.random.default_rng((seed, 7505))
        self._noise = rng.normal(0.0, NOISE, (lens.height + _POOL, lens.width + _POOL, 3)).astype(np.float32)

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image:
        (height, width), mix = image.shape[:2], hash((t, x, y, yaw))
        top, left = mix % _POOL, (mix >> 24) % _POOL
        noise = self._noise[top : top + height, left : left + width]
        return np.asarray(cv2.add(cv2.GaussianBlur(image, (0, 0), BLUR), noise, dtype=cv2.CV_8U), np.uint8)


class Smudges:
    """One to three patches of one grey that hide a tenth of the image circle; they stay where they are on the lens."""

    def __init__(self, lens: CameraModel, seed: tuple[int, ...]) -> None:
        rng = np.random.default_rng((*seed, 7504))
        hidden = self._hidden(lens, rng)
        soft = cv2.GaussianBlur(hidden.astype(np.float32), (0, 0), _EDGE)[..., None]
        self._seen = np.repeat(1.0 - soft, 3, axis=2)
        self._grey = np.repeat(soft * rng.uniform(20.0, 200.0), 3, axis=2)

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image:
        return np.asarray(image * self._seen + self._grey, np.uint8)

    @staticmethod
    def _hidden(lens: CameraModel, rng: np.random.Generator) -> NDArray[np.bool_]:
        """(H, W): ellipses, the last one grown until their share is right."""
        u, v = np.meshgrid(np.arange(lens.width) - lens.cx, np.arange(lens.height) - lens.cy)
        radius = lens.fx * lens.fov / 2.0
        circle = np.hypot(u, v) < radius
        hidden, patches = np.zeros_like(circle), int(rng.integers(1, MOST_PATCHES + 1))
        for number in range(patches):
            bearing, away = rng.uniform(-math.pi, math.pi), 0.9 * radius * math.sqrt(rng.random())
            turn, slim = rng.uniform(0.0, math.pi), rng.uniform(0.5, 1.0)
            du, dv = u - away * math.sin(bearing), v + away * math.cos(bearing)
            along, across = math.cos(turn) * du + math.sin(turn) * dv, math.cos(turn) * dv - math.sin(turn) * du
            size = np.hypot(along, across / slim)
            wanted = COVERED * (number + 1) / patches * np.count_nonzero(circle)
            free = size[circle & ~hidden]
            missing = round(wanted - np.count_nonzero(hidden & circle))
            hidden |= circle & (size <= np.partition(free, missing)[missing])
        return hidden
