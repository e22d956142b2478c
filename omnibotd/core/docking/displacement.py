"""How the view from one place maps to that from another: a similarity, for the ceiling moves as a plane does."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import wrap
from omnibotd.core.vision.frame import FloatImage

Floats = NDArray[np.float64]

# Two views of the same ceiling differ in scale by steps and beams in it, not more.
_MAX_LOG_SCALE = 0.12


@dataclass(frozen=True, slots=True)
class Displacement:
    """Takes a pixel q of the target view to the current view, both from the centre.

    q -> exp(log_scale) R(angle) q + (u, v).
    """

    angle: float
    u: float
    v: float
    log_scale: float = 0.0

    @classmethod
    def of_pose(cls, yaw: float, u: float, v: float) -> Displacement:
        """From where the current axis stands in the target view (u, v pixels) and how far it is turned."""
        c, s = math.cos(yaw), math.sin(yaw)
        return cls(wrap(-yaw), -(c * u + s * v), s * u - c * v)

    def pose(self) -> tuple[float, float, float]:
        """yaw (rad) and u, v (pixels) of the current view's axis in the target view."""
        c, s, shrink = math.cos(self.angle), math.sin(self.angle), math.exp(-self.log_scale)
        return wrap(-self.angle), -shrink * (c * self.u + s * self.v), shrink * (s * self.u - c * self.v)

    def zoomed(self, factor: float) -> Displacement:
        """The same between views `factor` times as many pixels wide."""
        return replace(self, u=self.u * factor, v=self.v * factor)

    def linear(self) -> Floats:
        """(2, 2) exp(log_scale) R(angle)."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return math.exp(self.log_scale) * np.array([[c, -s], [s, c]])

    def affine(self, size: int) -> Floats:
        """(2, 3) matrix for cv2.warpAffine with WARP_INVERSE_MAP, size x size pixels."""
        linear, centre = self.linear(), (size - 1) / 2.0
        offset = np.array([self.u + centre, self.v + centre]) - linear @ np.array([centre, centre])
        return np.hstack([linear, offset[:, None]])

    def stepped(self, step: Floats) -> Displacement:
        """After a small displacement on the target side; `step` = (turn, u, v[, log_scale])."""
        u, v = self.linear() @ step[1:3]
        grown = self.log_scale + (float(step[3]) if len(step) > 3 else 0.0)
        clipped = min(max(grown, -_MAX_LOG_SCALE), _MAX_LOG_SCALE)
        return Displacement(self.angle + float(step[0]), self.u + float(u), self.v + float(v), clipped)


@lru_cache(maxsize=8)
def axes(size: int) -> tuple[FloatImage, FloatImage]:
    """Coordinates u, v (size, size) of the pixels from the centre."""
    axis = (np.arange(size) - (size - 1) / 2.0).astype(np.float32)
    u, v = np.meshgrid(axis, axis)
    return u, v
