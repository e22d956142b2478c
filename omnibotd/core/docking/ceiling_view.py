"""One frame as the registration uses it: the ceiling's edges over 115 degrees, coarse to fine, without people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np

from omnibotd.core.docking.features import edges, evened, unoccluded
from omnibotd.core.docking.rectification import Lookup, Rectification, ceiling_rays, rim_rays
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import FloatImage, Frame, Image
from omnibotd.core.vision.view import cells_at

# The ceiling's edge is in view, which breaks the symmetry of a grid of tiles, and is all there is of a plain ceiling.
# Wider, more of the view is wall, and few lenses are known well that far off their axis.
_FOV = math.radians(115.0)
# Half the resolution is still finer than the view's pixels at the zenith.
_REDUCTION = 2
# Pixels a side of the layers. Each one's valley is as wide as the error the layer before leaves.
COARSE, MIDDLE, FINE = 60, 120, 240
# Edges of lamps are stronger than this, and shall not outweigh everything else.
_STRONGEST = np.float32(4.0)
# What of a smudge lies beyond the cells it was found in, in pixels of the fine layer: a square of so many.
_SMEARED = (9, 9)
_RIM_ZENITHS = np.radians(np.linspace(50.0, 86.0, 13))


@dataclass(frozen=True, slots=True)
class Layer:
    """One resolution: `picture` (size, size, 4) holds edge strength, its two derivatives a pixel, and 1 where seen.

    A point of the ceiling at (u, v) heights stands at column c + focal * u, row c + focal * v, c = (size - 1) / 2.
    """

    picture: FloatImage
    focal: float

    @property
    def size(self) -> int:
        return len(self.picture)


class CeilingView:
    """What one frame shows of the ceiling; computed as far as it is asked for."""

    def __init__(self, image: Image, valid: Image, focal: float, rim: Image | None) -> None:
        """`image` is rectified, FINE pixels a side, `valid` 255 where the lens sees; `rim` (rings, 360) or None."""
        self.image, self.focal, self.rim = image, focal, rim
        free = unoccluded(image)
        self._mask = valid if free is None else np.asarray(valid & free, np.uint8)
        self._layers: dict[int, Layer] = {}

    @cached_property
    def _magnitude(self) -> FloatImage:
        return edges(self.image)

    def feature(self, size: int) -> FloatImage:
        """Edge strength (size, size); smoothed a little where reduced, to widen the valley of an alignment."""
        if size == FINE:
            return np.minimum(evened(self._magnitude), _STRONGEST)
        small = np.asarray(cv2.resize(self._magnitude, (size, size), interpolation=cv2.INTER_AREA), np.float32)
        return np.asarray(cv2.GaussianBlur(np.minimum(evened(small), _STRONGEST), (0, 0), 0.7), np.float32)

    def mask(self, size: int) -> Image:
        """(size, size) 255 where the ceiling is seen."""
        return np.asarray(cv2.resize(self._mask, (size, size), interpolation=cv2.INTER_NEAREST), np.uint8)

    def layer(self, size: int) -> Layer:
        if size not in self._layers:
            feature = self.feature(size)
            slopes = (cv2.Sobel(feature, cv2.CV_32F, *axis, scale=1 / 8.0) for axis in ((1, 0), (0, 1)))
            seen = self.mask(size).astype(np.float32) / np.float32(255.0)
            picture = np.asarray(cv2.merge([feature, *slopes, seen]), np.float32)
            self._layers[size] = Layer(picture, self.focal * size / FINE)
        return self._layers[size]


class CeilingOptics:
    """Takes frames of one camera to views."""

    def __init__(self, camera: CameraModel) -> None:
        small = camera.reduced(_REDUCTION)
        self._rectify = Rectification(small, FINE, _FOV)
        self._cells = cells_at(ceiling_rays(FINE, _FOV))
        self._rim = Lookup(small, rim_rays(_RIM_ZENITHS, 360))
        self._sees_walls = bool(self._rim.valid.all())
        self._latest: tuple[Frame, CeilingView] | None = None  # every view of a dock asks for the same frame

    def view(self, frame: Frame) -> CeilingView:
        """Raises FrameError on a picture of another size than the camera's."""
        latest = self._latest
        if latest is None or latest[0] is not frame:
            latest = self._latest = frame, self._view(frame)
        return latest[1]

    def _view(self, frame: Frame) -> CeilingView:
        grey = frame.grey(_REDUCTION)
        rim = self._rim(grey) if self._sees_walls else None
        return CeilingView(self._rectify(grey), self._valid(frame), self._rectify.focal, rim)

    def _valid(self, frame: Frame) -> Image:
        if frame.dirty is None or not frame.dirty.any():
            return self._rectify.valid
        clean = np.where(frame.dirty.ravel()[self._cells], np.uint8(0), self._rectify.valid)
        return np.asarray(cv2.erode(clean, np.ones(_SMEARED, np.uint8)), np.uint8)


@lru_cache(maxsize=4)
def ceiling_optics(camera: CameraModel) -> CeilingOptics:
    """Tables are dear to compute and depend on the calibration only."""
    return CeilingOptics(camera)
