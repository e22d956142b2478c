"""A fisheye camera facing the floor of an arena with four blue tiles at its corners (thesis §6.4.1).

Where the thesis' tiles lay is not printed, nor how high its camera was.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.camera_model import CameraModel
from tools.sim.compass_tiles import BLUE
from tools.sim.lens import Image
from tools.sim.paint import wood

ARENA = (2.7, 2.4)  # m, centred on the origin
# m outside the arena's corners, so that the robot never stands on one; their side; the camera above the floor.
OUTSIDE, SIDE, HEIGHT = 0.1, 0.3, 1.2
_FLOOR, _SCALE = 9.0, 60.0  # m of floor that is painted, and texels a metre
_TEXELS = round(_FLOOR * _SCALE)
_BOARDS = (70.0, 105.0, 135.0)  # BGR
_NOISE, _BIAS = 2.0, 20.0  # grey values: of a webcam indoors, and what keeps noise positive in a byte
_POOL = 64  # px of shift of the one noise that all pictures are given
_WIDTH, _HEIGHT, _FOV = 640, 480, math.radians(190.0)


class FloorCamera:
    """Renders what the robot sees; deterministic by seed and by the order of calls."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng((seed, 61))
        self._floor = _painted(self._rng)
        self.model = CameraModel.equidistant(_WIDTH, _HEIGHT, _FOV)
        self._maps = _seen_floor(self.model)
        shape = (_HEIGHT + _POOL, _WIDTH + _POOL, 3)
        self._noise = np.clip(np.rint(_BIAS + _NOISE * self._rng.standard_normal(shape)), 0, 255).astype(np.uint8)

    @property
    def centre(self) -> tuple[float, float]:
        """Where the optical axis meets the picture, px."""
        return self.model.cx, self.model.cy

    def render(self, pose: Pose2D) -> Image:
        """(480, 640, 3) BGR."""
        seen = cv2.remap(self._round(pose), *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        top, left = self._rng.integers(_POOL, size=2)
        noise = self._noise[top : top + _HEIGHT, left : left + _WIDTH]
        return np.asarray(cv2.addWeighted(seen, 1.0, noise, 1.0, -_BIAS), np.uint8)

    def _round(self, pose: Pose2D) -> Image:
        """The floor round the robot, its front along the columns, its left along the rows."""
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        middle = np.array([[_TEXELS / 2.0 - 0.5 + pose.x * _SCALE], [_TEXELS / 2.0 - 0.5 + pose.y * _SCALE]])
        turn = np.array([[c, -s], [s, c]])
        floor_from_round = np.hstack([turn, middle - turn @ np.full((2, 1), _TEXELS / 2.0 - 0.5)])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = (_TEXELS, _TEXELS)
        return np.asarray(
            cv2.warpAffine(self._floor, floor_from_round, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8
        )


def _painted(rng: np.random.Generator) -> Image:
    """Boards with the four tiles; the first texel is at the corner of least x and y."""
    floor = np.clip(wood(rng, (_TEXELS, _TEXELS), _BOARDS), 0, 255).astype(np.uint8)
    half = SIDE / 2.0
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            middle = np.array([x, y]) * (np.array(ARENA) / 2.0 + OUTSIDE) + _FLOOR / 2.0
            (c0, r0), (c1, r1) = (np.rint((middle + off) * _SCALE).astype(int) for off in (-half, half))
            floor[r0:r1, c0:c1] = BLUE
    return floor


def _seen_floor(model: CameraModel) -> tuple[Image, Image]:
    """Where in the floor round the robot each pixel looks, as maps for OpenCV; at its edge above the horizon."""
    rays = model.unproject(np.stack(np.meshgrid(np.arange(_WIDTH), np.arange(_HEIGHT)), -1))
    # Facing down with its top still ahead, the picture is the mirror image of one that faces up.
    ahead, left, down = rays[..., 0], -rays[..., 1], np.maximum(rays[..., 2], 0.05)
    columns, rows = (np.nan_to_num(HEIGHT * part / down, nan=_FLOOR) * _SCALE + _TEXELS / 2.0 for part in (ahead, left))
    return cv2.convertMaps((columns - 0.5).astype(np.float32), (rows - 0.5).astype(np.float32), cv2.CV_16SC2)
