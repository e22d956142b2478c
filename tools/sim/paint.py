"""Painting of a room's surfaces in linear light: primitives, and how linear light becomes a texture.

Surfaces are first what they reflect (albedo); lighting.py puts light on them; `develop` makes the texture.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.sim.lens import Image, Sensor
from tools.sim.room import CEILING_SCALE, Room

Light = NDArray[np.float32]  # (H, W, 3) BGR, linear; 1 is a white surface in normal light
Area = tuple[float, float, float, float]
Colour = Sequence[float] | float

_GAMMA = 1 / 2.2


def ceiling_canvas(room: Room, albedo: Sequence[float] = (0.72, 0.76, 0.78)) -> Light:
    """One colour over the whole ceiling; its first texel is at the corner (xmin, ymin)."""
    return np.full((*ceiling_shape(room), 3), albedo, np.float32)


def ceiling_shape(room: Room) -> tuple[int, int]:
    return round(room.depth * CEILING_SCALE), round(room.width * CEILING_SCALE)


def blotches(rng: np.random.Generator, shape: tuple[int, int], size: float, contrast: float) -> Light:
    """Soft noise (H, W, 1) about 1: features of `size` texels, standard deviation `contrast`."""
    small = [max(2, round(n / size) + 2) for n in shape]
    coarse = rng.standard_normal(small).astype(np.float32)
    smooth = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(1.0 + smooth * (contrast / float(smooth.std())), np.float32)[:, :, None]


def wood(rng: np.random.Generator, shape: tuple[int, int], colour: Sequence[float]) -> Light:
    """Grain (H, W, 3) that runs along the columns' direction, down the picture."""
    grain = blotches(rng, (-(-shape[0] // 10), shape[1]), 3.0, 0.18).repeat(10, axis=0)[: shape[0]]
    board = np.full((*shape, 3), colour, np.float32) * np.clip(grain, 0.4, 1.8)
    return np.asarray(board * blotches(rng, shape, 30.0, 0.15), np.float32)


def box(canvas: Light, area: Area, value: Colour, scale: float = CEILING_SCALE) -> None:
    """Fills the rectangle (x0, y0, x1, y1), in metres."""
    c0, r0, c1, r1 = (max(0, round(edge * scale)) for edge in area)
    canvas[r0:r1, c0:c1] = value


def disc(canvas: Light, centre: tuple[float, float], radius: float, value: Colour) -> None:
    """Fills a circle on the ceiling, in metres from its corner."""
    colour = [value] * 3 if isinstance(value, float) else list(value)
    texel = [round((metres * CEILING_SCALE - 0.5) * 16) for metres in centre]
    cv2.circle(canvas, texel, round(radius * CEILING_SCALE * 16), colour, -1, cv2.LINE_8, 4)


def glare(light: Light, scale: float) -> Light:
    """Light scattered in the lens around very bright places; so smooth that a quarter of the texels will do."""
    excess = cv2.resize(np.maximum(light - 1.0, 0.0), None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    near, far = (cv2.GaussianBlur(excess, (0, 0), spread * scale / 4.0) for spread in (0.10, 0.3))
    halo = cv2.resize(near * 0.05 + far * 0.02, light.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(light + halo, np.float32)


def develop(light: Light, exposure: float = 1.0) -> Image:
    """The texture (uint8) of linear light, with the room above white that the sensor expects."""
    grey = np.maximum(light * exposure, 0.0) ** _GAMMA * (228.0 / Sensor.HEADROOM)
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8)
