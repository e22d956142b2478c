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
    """r = f * theta up to half of `fov_deg`, where r is `radius` px; pixel centres are whole numbers.

    `offset`: px by which the optical axis lies right of and below the picture's centre.
    """

    width: int = 640
    height: int = 480
    fov_deg: float = 190.0
    radius: float = 240.0
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def focal(self) -> float:
        """Pixels per radian."""
        return self.radius / math.radians(self.fov_deg / 2.0)

    @property
    def block(self) -> tuple[slice, slice]:
        """Rows and columns of the smallest block of the picture that holds the image circle."""
        middle = (self.height / 2 + self.offset[1], self.width / 2 + self.offset[0])
        rows, columns = (
            slice(max(0, math.floor(at - self.radius)), min(size, math.ceil(at + self.radius)))
            for at, size in zip(middle, (self.height, self.width), strict=True)
        )
        return rows, columns

    def rays(self) -> tuple[Floats, Floats]:
        """(zenith angle, bearing from the robot's front, CCW) of every pixel of the block, radians.

        Image top is the front, image right the robot's left: u = cx + f theta sin b, v = cy - f theta cos b.
        """
        rows, columns = self.block
        v = np.arange(rows.start, rows.stop)[:, None] - (self.height - 1) / 2.0 - self.offset[1]
        u = np.arange(columns.start, columns.stop)[None, :] - (self.width - 1) / 2.0 - self.offset[0]
        return (np.hypot(u, v) / self.focal).astype(np.float32), np.arctan2(u, -v).astype(np.float32)

    def seen_scale(self, theta: Floats, rise: float) -> Floats:
        """Pixels a metre at which a plane `rise` m above the camera appears (geometric mean of both axes)."""
        angle = np.clip(theta, 1e-3, math.radians(89.0))
        radial = self.focal * np.cos(angle) ** 2 / rise
        tangential = self.focal * angle / (rise * np.tan(angle))
        return np.asarray(np.sqrt(radial * tangential), np.float32)


class Rays:
    """Where the pixels of the image circle look, as lists sorted from the zenith outwards.

    What lies inside or outside some angle is then a slice. They are sorted by thin ring only and keep the
    picture's order within one, so that neighbours in the list stay neighbours in the picture.
    """

    ROW = 512  # a list longer than 32767 px needs rows for OpenCV
    RINGS = 512  # a quarter of a degree or less

    def __init__(self, lens: Lens) -> None:
        self.lens = lens
        half = math.radians(lens.fov_deg / 2.0)
        theta, bearing = (angles.ravel() for angles in lens.rays())
        ring = np.floor(theta * (self.RINGS / half)).astype(np.int16)
        inside = np.flatnonzero(theta < half)
        order = inside[np.argsort(ring[inside], kind="stable")]
        self.count = len(order)
        self.theta, self.bearing = theta[order], bearing[order]
        self.tan = np.tan(np.minimum(self.theta, math.radians(89.0)))
        self.ahead, self.left = self.tan * np.cos(self.bearing), self.tan * np.sin(self.bearing)
        self._edges = np.linspace(0.0, half, self.RINGS + 1)
        self._starts = np.searchsorted(ring[order], np.arange(self.RINGS + 1))
        self._listed = np.full(theta.size, self.count, np.intp)  # where each pixel of the block is in the lists
        self._listed[order] = np.arange(self.count)
        self._block = np.empty(theta.size, np.uint32)

    @property
    def padded(self) -> int:
        """Length of the lists filled up to whole rows, with one place or more for what is outside the circle."""
        return (self.count // self.ROW + 1) * self.ROW

    def within(self, theta: float) -> int:
        """The first so many rays of the list are less than `theta` rad off the zenith, and few others."""
        return int(self._starts[max(0, int(np.searchsorted(self._edges, theta, "right")) - 1)])

    def beyond(self, theta: float) -> int:
        """From this one on, the listed rays are more than `theta` rad off the zenith; few before it are."""
        return int(self._starts[min(self.RINGS, int(np.searchsorted(self._edges, theta, "left")))])

    def picture(self, pixels: Image) -> Image:
        """The block (H, W, 3) of listed pixels (n, 4); outside the circle it shows the one at `count`.

        Valid until the next call.
        """
        pixels.view(np.uint32).ravel().take(self._listed, out=self._block, mode="clip")
        rows, columns = self.lens.block
        shape = (rows.stop - rows.start, columns.stop - columns.start, 4)
        return np.asarray(cv2.cvtColor(self._block.view(np.uint8).reshape(shape), cv2.COLOR_BGRA2BGR), np.uint8)


class Sensor:
    """Vignetting, slowly drifting automatic exposure, lens blur and noise, determined by seed and shot.

    Pictures are gamma-coded, and under a square-root-like code photon noise has the same size at every grey
    value: one additive noise is shot and read noise in one.
    """

    NOISE = 1.8  # grey values, typical of a webcam indoors
    HEADROOM = 1.45  # grey values of the picture a grey value rendered: lamps are brighter than 255
    BLUR = 0.55  # px, standard deviation
    FALL_OFF = 0.28  # loss of light at the rim, gamma-coded
    _POOL = 128  # px of shift that the pool allows: 128 x 128 different noises, longer than a run notices

    def __init__(self, rays: Rays, seed: int, noise: float = NOISE) -> None:
        """`noise`: standard deviation in grey values."""
        self._rays, lens = rays, rays.lens
        rng = np.random.default_rng((seed, 7301))
        theta = rays.theta / math.radians(lens.fov_deg / 2.0)
        fall_off = np.zeros(rays.padded, np.uint8)
        fall_off[: rays.count] = np.rint(255.0 * (1.0 - self.FALL_OFF * theta**2))
        self._vignette = cv2.merge([fall_off.reshape(-1, rays.ROW)] * 4)
        self._phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        size = (lens.height + self._POOL, lens.width + self._POOL, 3)
        pool = rng.standard_normal(size, np.float32) * noise
        pool += rng.standard_normal((*size[:2], 1), np.float32) * (0.5 * noise)  # luminance shares a part
        levels = np.rint(pool)
        self._brighter = np.clip(levels, 0, 255).astype(np.uint8)
        self._darker = np.clip(-levels, 0, 255).astype(np.uint8)
        self._canvas = np.zeros((lens.height, lens.width, 3), np.uint8)

    def gain(self, t: float) -> float:
        """The exposure at time t (s), about 1: two slow waves with the seed's phases."""
        first, second = self._phase
        return 1.0 + 0.04 * math.sin(t / 7.5 + first) + 0.02 * math.sin(t / 2.1 + second)

    def expose(self, pixels: Image, shot: tuple[float, ...]) -> Image:
        """The picture of the listed pixels (rows, ROW, 4), which are used up; `shot` = (t, x, y, yaw)."""
        lens = self._rays.lens
        scale = self.HEADROOM / 255.0 * self.gain(shot[0])
        cv2.multiply(pixels, self._vignette, scale=scale, dst=pixels)
        self._canvas[lens.block] = self._rays.picture(pixels)
        picture = cv2.GaussianBlur(self._canvas, (3, 3), self.BLUR)
        mix = hash(shot)  # numbers hash alike in every process
        top, left = mix % self._POOL, (mix >> 24) % self._POOL
        window = np.s_[top : top + lens.height, left : left + lens.width]
        cv2.add(picture, self._brighter[window], dst=picture)
        return np.asarray(cv2.subtract(picture, self._darker[window], dst=picture), np.uint8)
