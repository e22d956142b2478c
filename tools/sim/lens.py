"""The simulated camera: an ideal equidistant fisheye looking straight up, and what it does to a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Lens:
    """r = f * theta up to half of `fov_deg`, where r is `radius` px; pixel centres are whole numbers."""

    width: int = 640
    height: int = 480
    fov_deg: float = 190.0
    radius: float = 240.0

    @property
    def focal(self) -> float:
        """Pixels per radian."""
        return self.radius / math.radians(self.fov_deg / 2.0)

    @property
    def block(self) -> tuple[slice, slice]:
        """Rows and columns of the smallest block of the picture that holds the image circle."""
        rows, columns = (
            slice(max(0, math.floor(size / 2 - self.radius)), min(size, math.ceil(size / 2 + self.radius)))
            for size in (self.height, self.width)
        )
        return rows, columns

    def rays(self) -> tuple[Floats, Floats]:
        """(zenith angle, bearing from the robot's front, CCW) of every pixel of the block, radians.

        Image top is the front, image right the robot's left: u = cx + f theta sin b, v = cy - f theta cos b.
        """
        rows, columns = self.block
        v = np.arange(rows.start, rows.stop)[:, None] - (self.height - 1) / 2.0
        u = np.arange(columns.start, columns.stop)[None, :] - (self.width - 1) / 2.0
        return (np.hypot(u, v) / self.focal).astype(np.float32), np.arctan2(u, -v).astype(np.float32)


class Sensor:
    """Vignetting, slowly drifting automatic exposure, lens blur and noise, determined by seed and shot.

    Pictures are gamma-coded, and under a square-root-like code photon noise has the same size at every grey
    value: one additive noise is shot and read noise in one.
    """

    NOISE = 1.8  # grey values, typical of a webcam indoors
    BLUR = 0.55  # px, standard deviation
    FALL_OFF = 0.28  # loss of light at the rim, gamma-coded
    _ZERO = 16  # the noise pool is unsigned: this stands for none
    _POOL = 128  # px of shift that the pool allows: 128 x 128 different noises, longer than a run notices

    def __init__(self, lens: Lens, seed: int, headroom: float) -> None:
        """`headroom`: grey values of the picture per grey value rendered (lamps are brighter than 255)."""
        rng = np.random.default_rng((seed, 7301))
        theta = np.minimum(lens.rays()[0] / math.radians(lens.fov_deg / 2.0), 1.0)
        fall_off = np.rint(255.0 * (1.0 - self.FALL_OFF * theta**2)).astype(np.uint8)
        self._vignette = cv2.merge([fall_off] * 3)
        self._scale = headroom / 255.0
        self._phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        size = (lens.height + self._POOL, lens.width + self._POOL, 3)
        noise = rng.standard_normal(size, np.float32) * self.NOISE
        noise += rng.standard_normal((*size[:2], 1), np.float32) * (0.5 * self.NOISE)  # luminance shares a part
        self._noise = np.clip(np.rint(noise + self._ZERO), 0, 255).astype(np.uint8)

    def gain(self, t: float) -> float:
        """The exposure at time t (s), about 1: two slow waves with the seed's phases."""
        first, second = self._phase
        return 1.0 + 0.04 * math.sin(t / 7.5 + first) + 0.02 * math.sin(t / 2.1 + second)

    def expose(self, block: Image, canvas: Image, lens: Lens, shot: tuple[float, ...]) -> Image:
        """The picture: `block` with vignetting and gain set into black `canvas`, blurred, with noise.

        `shot` = (t, x, y, yaw); `canvas` (H, W, 3) is written to.
        """
        rows, columns = lens.block
        scale = self._scale * self.gain(shot[0])
        canvas[rows, columns] = cv2.multiply(block, self._vignette, scale=scale)
        blurred = cv2.GaussianBlur(canvas, (3, 3), self.BLUR)
        mix = hash(shot)  # numbers hash alike in every process
        top, left = mix % self._POOL, (mix >> 24) % self._POOL
        noise = self._noise[top : top + lens.height, left : left + lens.width]
        return np.asarray(cv2.addWeighted(blurred, 1.0, noise, 1.0, -self._ZERO), np.uint8)
