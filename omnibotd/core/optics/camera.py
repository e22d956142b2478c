"""Cameras that look at a mirror: any lens with one viewpoint will do.

Camera axes: x to the right of the picture, y to its top, the scene at z < 0. Pixels are (u, v), v downwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from omnibotd.core.optics.rigid import Floats


class Camera(Protocol):
    """A central camera."""

    def rays(self, pixels: Floats) -> Floats:
        """Unit directions (n, 3) in which pixels (n, 2) look."""
        ...

    def pixels(self, rays: Floats) -> Floats:
        """Where directions (n, 3) of any length appear (n, 2); NaN where the lens cannot see."""
        ...


@dataclass(frozen=True, slots=True)
class Pinhole:
    """No distortion; `focal` and the centre in pixels."""

    focal: float
    cx: float
    cy: float

    def rays(self, pixels: Floats) -> Floats:
        """Eq 4.17, with the sign that keeps the picture upright (scene at z < 0)."""
        u, v = pixels.T
        rays = np.stack([u - self.cx, self.cy - v, np.full(len(pixels), -self.focal)], axis=1)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True), np.float64)

    def pixels(self, rays: Floats) -> Floats:
        """Eq 4.33."""
        x, y, z = rays.T
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(z < 0.0, self.focal / -z, np.nan)
        return np.stack([self.cx + scale * x, self.cy - scale * y], axis=1)
