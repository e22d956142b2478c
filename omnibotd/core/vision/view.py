"""The view: what a place looks like, whatever the light: a gradient image on rings and sectors about the vertical.

Rings are zenith angles, sectors bearings in the base frame, so tilt, mounting and distortion are all undone here and a
turn on the spot is a circular shift.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import FrameError
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import FloatImage, Frame, Image

RINGS, SECTORS = 16, 64

# Pixels per radian at which the gradient is taken: fine enough for ceiling tiles, coarse enough to be blind to blur.
_FOCAL = 36.2
# Zenith angles sampled (rad): 2 to 50 px at that focal length. Beyond 79 degrees most lenses show walls and people.
_NEAREST, _FARTHEST = 2.0 / _FOCAL, 50.0 / _FOCAL
# Each cell is the mean of 2 x 2 samples, else thin lamps fall between the samples.
_OVERSAMPLING = 2
# Gradient over local mean gradient: the 21 px box is about a lamp's size; 12 keeps sensor noise from being amplified.
_BOX, _NOISE = (21, 21), 12.0
# The image circle's own rim is no part of the world: keep this many reduced pixels away from it.
_RIM = 4.0

View = NDArray[np.float32]


def relative_gradient(grey: Image) -> FloatImage:
    """|Sobel| over its own local mean, (H, W): unchanged by gain, little by shadow ("ngrad")."""
    dx, dy = cv2.spatialGradient(grey)  # Sobel's, in 16-bit integers
    gradient = cv2.magnitude(dx.astype(np.float32), dy.astype(np.float32))
    return np.asarray(gradient / (cv2.blur(gradient, _BOX) + _NOISE), np.float32)


def reduction_for(camera: CameraModel) -> int:
    """How many times smaller to decode a frame, in {1, 2, 4, 8}, so that the focal length is nearest the tuned one."""
    return 1 << min(max(round(math.log2(max(camera.fx, 1.0) / _FOCAL)), 0), 3)


class Viewer:
    """Turns frames of one camera into views."""

    def __init__(self, camera: CameraModel) -> None:
        self.reduction = reduction_for(camera)
        small = camera.reduced(self.reduction)
        self._size = (small.height, small.width)
        pixels, inside = _sample_points(small)
        self._u = np.ascontiguousarray(pixels[..., 0], np.float32)
        self._v = np.ascontiguousarray(pixels[..., 1], np.float32)
        share = _cell_means(inside.astype(np.float32))
        self.seen = share >= 0.5
        self._cells_seen = int(self.seen.sum())
        self._cell_scale = np.where(self.seen, 1.0 / np.maximum(share, 0.25), 0.0).astype(np.float32)
        if self.seen.mean() < 0.3:
            raise FrameError(
                f"camera model {camera.width}x{camera.height} px, fx {camera.fx:.0f}: only {self.seen.mean():.0%} of "
                "what lies within 79 degrees of the vertical is in the image; check camera.calibration, "
                "camera.tilt and camera.fov_deg"
            )

    def texture(self, frame: Frame) -> View:
        """(RINGS, SECTORS) relative gradient; zero where the camera doesn't see. FrameError: wrong size."""
        grey = frame.grey(self.reduction)
        if grey.shape != self._size:
            (height, width), k = grey.shape, self.reduction
            raise FrameError(
                f"frame is about {width * k}x{height * k} px, the camera model is for "
                f"{self._size[1] * k}x{self._size[0] * k}: calibrate at the size that is used"
            )
        samples = cv2.remap(relative_gradient(grey), self._u, self._v, cv2.INTER_LINEAR)
        return np.asarray(_cell_means(np.asarray(samples, np.float32)) * self._cell_scale, np.float32)

    def normalised(self, texture: View) -> View:
        """Zero mean and unit variance over the cells seen, zero elsewhere; all zero without any contrast."""
        mean = float(texture.sum()) / self._cells_seen  # cells that are not seen are zero
        apart = (texture - np.float32(mean)) * self.seen
        spread = math.sqrt(float(np.vdot(apart, apart)) / self._cells_seen)
        return np.asarray(apart / np.float32(spread)) if spread > 1e-6 else np.zeros_like(texture)

    def contrast(self, texture: View) -> float:
        """How much there is to see: spread of the relative gradient (sensor noise below 0.1, lamps and tiles 0.5)."""
        return float(texture[self.seen].std())


def cells_at(rays: NDArray[np.float64]) -> NDArray[np.intp]:
    """(...) flat index of the cell of a view that each ray (..., 3) in the base frame falls in, or of the nearest."""
    x, y, z = np.moveaxis(rays, -1, 0)
    rings = (np.arctan2(np.hypot(x, y), z) - _NEAREST) / (_FARTHEST - _NEAREST) * RINGS
    sectors = np.rint(np.arctan2(y, x) * SECTORS / (2.0 * math.pi)).astype(np.intp) % SECTORS
    return np.asarray(np.clip(rings.astype(np.intp), 0, RINGS - 1) * SECTORS + sectors)


def _sample_points(camera: CameraModel) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Pixels (rings * 2, sectors * 2, 2) of the sampling rays, and which of them the camera sees."""
    rings, sectors = RINGS * _OVERSAMPLING, SECTORS * _OVERSAMPLING
    zenith = _NEAREST + (np.arange(rings) + 0.5) * (_FARTHEST - _NEAREST) / rings
    bearing = (np.arange(sectors) - (_OVERSAMPLING - 1) / 2.0) * 2.0 * math.pi / sectors
    z, b = np.meshgrid(zenith, bearing, indexing="ij")
    rays = np.stack([np.sin(z) * np.cos(b), np.sin(z) * np.sin(b), np.cos(z)], -1)
    pixels = replace(camera, fov=camera.fov - 2.0 * _RIM / camera.fx).project(rays)
    u, v = pixels[..., 0], pixels[..., 1]
    inside = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    return np.where(inside[..., None], pixels, -10.0), inside


def _cell_means(samples: FloatImage) -> View:
    # At a whole factor INTER_AREA is the plain mean of every block.
    return np.asarray(cv2.resize(samples, (SECTORS, RINGS), interpolation=cv2.INTER_AREA), np.float32)
