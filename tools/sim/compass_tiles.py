"""A red and a blue tile on the ceiling of any world: the artificial compass of the thesis (§6.5.2).

Nothing is known of the ceiling of somebody else's world, so the tiles hang at a fixed height over its middle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import cv2
import numpy as np

from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Image
from tools.sim.world_plugin import World

SIDE, APART = 0.35, 0.8  # m: of a tile, and between the two middles
HEIGHT = 2.2  # m above the camera
RED, BLUE = (35.0, 35.0, 205.0), (205.0, 60.0, 30.0)  # BGR in a picture whose mean is NORMAL
NORMAL = 85.0  # grey value
_EDGE_POINTS = 6  # of each side of a tile: seen through a fisheye it is bent
_SHIFT = 4  # binary places of a pixel, for outlines that move smoothly


def with_compass_tiles(world: World) -> World:
    """The same world with two tiles over the middle of its bounds, red at -x, blue at +x."""
    return cast(World, _Tiled(world))


class _Tiled:
    """Paints into what the world renders; all else is the world's own."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._camera: CameraModel | None = None
        self._seen = np.zeros((0, 0), bool)
        xmin, ymin, xmax, ymax = world.bounds
        x, y = (xmin + xmax) / 2.0, (ymin + ymax) / 2.0
        self._tiles = [(_outline(x - APART / 2.0, y), RED), (_outline(x + APART / 2.0, y), BLUE)]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._world, name)

    def render(self, x: float, y: float, yaw: float, t: float) -> Image:
        image = self._world.render(x, y, yaw, t)
        if self._camera is None:
            self._camera = lens_of(self._world, image)
            self._seen = _field_of_view(self._camera)
        painted = image.copy()
        light = cv2.mean(image, self._seen.astype(np.uint8))
        brightness = sum(light[:3]) / 3.0 / NORMAL  # so that the dark stays dark
        for outline, colour in self._tiles:
            pixels = self._camera.project(_from_base(outline, x, y, yaw))
            if np.isfinite(pixels).all():
                shade = tuple(min(255.0, brightness * value) for value in colour)
                points = np.rint(pixels * 2**_SHIFT).astype(np.int32)
                cv2.fillPoly(painted, [points], shade, cv2.LINE_AA, _SHIFT)
        return painted


def lens_of(world: World, image: Image) -> CameraModel:
    """The world's camera_info where it has one, else equidistant, filling the smaller side of its picture."""
    fov = math.radians(world.fov_deg)
    info = getattr(world, "camera_info", None)
    if isinstance(info, Mapping):
        return CameraModel.from_camera_info(info, fov)
    height, width = image.shape[:2]
    return CameraModel.equidistant(width, height, fov)


def _outline(x: float, y: float) -> np.ndarray:
    """(n, 2) points round a tile whose middle is at (x, y), m."""
    along = np.linspace(-0.5, 0.5, _EDGE_POINTS, endpoint=False) * SIDE
    side = np.stack([along, np.full_like(along, -SIDE / 2.0)], -1)
    turns = [np.array([[c, s], [-s, c]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return np.concatenate([side @ turn for turn in turns]) + np.array([x, y])


def _from_base(points: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """Rays (n, 3) to points (n, 2) at the tiles' height, from a robot at (x, y, yaw)."""
    dx, dy = (points - [x, y]).T
    c, s = math.cos(yaw), math.sin(yaw)
    return np.stack([c * dx + s * dy, c * dy - s * dx, np.full(len(points), HEIGHT)], -1)


def _field_of_view(camera: CameraModel) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.isfinite(camera.unproject(np.stack([columns, rows], -1))).all(-1)
