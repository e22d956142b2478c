"""A small painted ceiling with compass tiles, drawn here: quick, and with nothing of the simulator's rooms in it."""

import math

import cv2
import numpy as np

from tools.sim.compass_tiles import HEIGHT, with_compass_tiles
from tools.sim.world_plugin import World

SIDE = 3.0  # m, square and centred on the origin


class PaintedCeiling:
    """An endless ceiling of grey blotches 2.2 m above a 640x480 equidistant camera of 190 degrees, no walls."""

    fov_deg = 190.0
    bounds = (-SIDE / 2, -SIDE / 2, SIDE / 2, SIDE / 2)
    dock = (SIDE / 2 - 0.25, 0.0, 0.0)

    _SCALE = 40.0  # texels a metre

    def __init__(self, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        texture = np.zeros((480, 480), np.float32)
        for size, weight in ((8, 1.0), (24, 1.0)):
            texture += weight * cv2.resize(rng.normal(size=(480 // size,) * 2).astype(np.float32), (480, 480))
        self._texture = np.clip(110.0 + 35.0 * texture, 0, 255).astype(np.uint8)
        v, u = np.mgrid[0:480, 0:640].astype(np.float32)
        u, v = u - 319.5, v - 239.5
        theta = np.hypot(u, v) / (240.0 / math.radians(95.0))
        across = np.tan(np.minimum(theta, 1.35)) * HEIGHT
        bearing = np.arctan2(u, -v)
        self._ahead, self._left = across * np.cos(bearing), across * np.sin(bearing)
        self._inside = (theta < math.radians(95.0)).astype(np.uint8)[..., None]

    def free(self, x: float, y: float, radius: float) -> bool:
        return max(abs(x), abs(y)) + radius <= SIDE / 2

    def render(self, x: float, y: float, yaw: float, t: float) -> np.ndarray:
        c, s = math.cos(yaw), math.sin(yaw)
        east = (x + c * self._ahead - s * self._left) * self._SCALE + 240.0
        north = (y + s * self._ahead + c * self._left) * self._SCALE + 240.0
        grey = cv2.remap(
            self._texture,
            east.astype(np.float32),
            north.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT_101,
        )
        return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) * self._inside


def room_with_tiles(seed: int = 1) -> World:
    return with_compass_tiles(PaintedCeiling(seed))
