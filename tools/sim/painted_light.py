"""Other light for worlds that can't make it themselves: pictures dimmed, glared and made noisy as a camera would."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Image

CEILING = 2.2  # m above the camera; a world does not say, and light falls off softly anyway
_COARSE = 16  # px a cell of the field of light: it has no edges
_MOST = 2.5  # brightest factor of the field
_ZERO = 64  # the noise pool is unsigned: this stands for none
_POOL = 64  # px of shift that the noise pool allows

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Light:
    """Brightness factors at the window (xmin) and at the far wall (xmax), and how sharp the change between them is.

    Where the factor is below `lit`, lamps are out: nothing there is brighter than `cap` grey values before dimming.
    `sun` is the extra factor of a patch of sunlight; `noise` grey values of the sensor's higher gain.
    """

    window: float
    far: float
    sharp: float
    lit: float
    cap: float
    sun: float = 0.0
    noise: float = 0.0


LIGHTS = {
    "half_lamps": Light(1.0, 0.55, 10.0, lit=0.8, cap=200.0, noise=1.0),
    "lamps_off": Light(0.85, 0.45, 4.0, lit=9.0, cap=190.0, noise=2.0),
    "sun": Light(0.95, 0.7, 4.0, lit=0.0, cap=255.0, sun=1.3),
    "night": Light(0.30, 0.18, 3.0, lit=9.0, cap=170.0, noise=5.0),
}


class PaintedLight:
    """One light over a whole room; the seed places the patch of sun and makes the noise."""

    def __init__(self, light: Light, lens: CameraModel, bounds: tuple[float, float, float, float], seed: int) -> None:
        rng = np.random.default_rng((seed, 7503))
        self._light, self._low, self._high = light, np.array(bounds[:2]), np.array(bounds[2:])
        self._sun = self._low + (self._high - self._low) * rng.uniform(0.25, 0.75, 2)
        columns, rows = (np.arange(0.5, math.ceil(size / _COARSE)) * _COARSE for size in (lens.width, lens.height))
        rays = np.nan_to_num(lens.unproject(np.stack(np.meshgrid(columns, rows), -1)))
        self._across = rays[..., :2] * (CEILING / np.maximum(rays[..., 2:], 0.05))
        noise = rng.normal(_ZERO, max(light.noise, 1e-6), (lens.height + _POOL, lens.width + _POOL, 3))
        self._noise = np.clip(np.rint(noise), 0, 255).astype(np.uint8)

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image:
        factor = self._factor(x, y, yaw)
        height, width = image.shape[:2]
        cap = np.where(factor < self._light.lit, self._light.cap, 255.0)
        image = np.minimum(image, _enlarged(cap, width, height))
        image = cv2.multiply(image, _enlarged(factor * (255.0 / _MOST), width, height), scale=_MOST / 255.0)
        return self._noisy(np.asarray(image, np.uint8), hash((t, x, y, yaw)))

    def _factor(self, x: float, y: float, yaw: float) -> Floats:
        """The field of light as the camera sees it, coarse."""
        c, s = math.cos(yaw), math.sin(yaw)
        at = self._across @ np.array([[c, s], [-s, c]]) + (x, y)
        at = np.clip(at, self._low, self._high)
        depth = (at[..., 0] - self._low[0]) / (self._high[0] - self._low[0])
        far = 1.0 / (1.0 + np.exp(-self._light.sharp * (2.0 * depth - 1.0)))
        factor = self._light.window + (self._light.far - self._light.window) * far
        patch = np.exp(-(((at - self._sun) / (0.9, 0.5)) ** 4).sum(-1))
        return np.asarray(np.minimum(factor + self._light.sun * patch, _MOST))

    def _noisy(self, image: Image, mix: int) -> Image:
        height, width = image.shape[:2]
        top, left = mix % _POOL, (mix >> 24) % _POOL
        noise = self._noise[top : top + height, left : left + width]
        return np.asarray(cv2.addWeighted(image, 1.0, noise, 1.0, -_ZERO), np.uint8)


def _enlarged(field: Floats, width: int, height: int) -> Image:
    """(height, width, 3) uint8 of a coarse field of grey values."""
    wide = cv2.resize(np.rint(field).astype(np.uint8), (field.shape[1] * _COARSE, field.shape[0] * _COARSE))
    return np.asarray(cv2.merge([wide[:height, :width]] * 3), np.uint8)
