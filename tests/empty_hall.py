"""A world for what needs a daemon and a robot, but no place to be recognised: fast."""

from __future__ import annotations

import cv2
import numpy as np


class EmptyHall:
    """A large empty floor under a picture that never changes."""

    fov_deg = 190.0
    bounds = (-10.0, -10.0, 10.0, 10.0)
    dock = (9.0, 0.0, 0.0)

    def __init__(self) -> None:
        noise = np.random.default_rng(1).integers(60, 200, (120, 160, 3), dtype=np.uint8)
        disc = cv2.circle(np.zeros((120, 160), np.uint8), (80, 60), 59, 255, -1)
        self._image = cv2.bitwise_and(noise, noise, mask=disc)

    def free(self, x: float, y: float, radius: float) -> bool:
        return max(abs(x), abs(y)) + radius <= 10.0

    def render(self, x: float, y: float, yaw: float, t: float) -> np.ndarray:
        return self._image
