"""Reflection in a cone whose tip is the origin and whose axis is z, body at z < 0 (thesis, section 4.6).

Neither direction assumes where the camera is, as long as it is outside the cone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.optics.rigid import Floats
from omnibotd.core.optics.root import bracketed_root

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Cone:
    """A mirror of `radius` m at its base; `ratio` = height / radius, 1 for the thesis' 90 degree cone."""

    radius: float
    ratio: float = 1.0

    def __post_init__(self) -> None:
        if not (self.radius > 0.0 and self.ratio > 0.0):
            raise ValueError(f"a cone of radius {self.radius} m and ratio {self.ratio}: both must be positive")

    def struck(self, origin: Floats, rays: Floats) -> Floats:
        """Where rays (n, 3) from one `origin` (3,) first meet the mirror (n, 3); NaN where they miss it (Eq 4.19)."""
        squash = np.array([-(self.ratio**2), -(self.ratio**2), 1.0])
        a, b, k = rays**2 @ squash, rays * origin @ squash, float(origin**2 @ squash)
        with np.errstate(divide="ignore", invalid="ignore"):
            q = -(b + np.copysign(np.sqrt(b * b - a * k), b))  # the root without cancellation; k / q is the other
            reach = np.stack([q / a, k / q])
            height = origin[2] + reach * rays[:, 2]
            good = (reach > 0.0) & (height < 0.0) & (height >= -self.ratio * self.radius)
        nearest = np.where(good, reach, np.inf).min(axis=0)
        nearest[np.isinf(nearest)] = np.nan
        return np.asarray(origin + nearest[:, None] * rays, np.float64)

    def reflected(self, points: Floats, rays: Floats) -> Floats:
        """Directions (n, 3) in which rays go on that strike the cone at `points` (Eq 4.23)."""
        x, y, z = points.T
        normal = np.stack([-x * z, -y * z, x * x + y * y], axis=1)
        with np.errstate(invalid="ignore"):
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return np.asarray(rays - 2.0 * np.sum(rays * normal, axis=1, keepdims=True) * normal, np.float64)

    def mirrored(self, eye: Floats, points: Floats) -> Floats:
        """Where on the mirror an `eye` (3,) sees points (n, 3); NaN where it does not.

        Light takes the shortest way over the mirror. Along one straight line from tip to base that way is known in
        closed form (unfold both points into one plane), which leaves one unknown, the azimuth. The way is a convex
        function and the cone a convex set, so that between the azimuths at which eye and point both see the
        mirror's outside it has one stationary point at most: a bracketed root finds it without a good start.
        """
        start, low, high = self._bracket(eye, points)
        found = np.full(points.shape, np.nan)
        some = np.flatnonzero(low < high)

        def slope(turn: Floats) -> Floats:
            return self._slope(eye, points[some], start[some] + turn)

        turn = bracketed_root(slope, low[some], high[some])
        on_mirror = self._shortest(eye, points[some], start[some] + turn)[0]
        depth = -on_mirror[:, 2]
        seen = (depth > 0.0) & (depth <= self.ratio * self.radius)
        found[some[seen]] = on_mirror[seen]
        return found

    def _bracket(self, eye: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
        """(azimuth, turn from, turn to): where the reflection can only be; empty (from >= to) if there is none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            pull = eye / np.linalg.norm(eye) + points / np.linalg.norm(points, axis=1, keepdims=True)
            start = np.arctan2(pull[:, 1], pull[:, 0])
            # Beyond this turn from the tip's pull, the shortest way along a line is the one over the tip.
            widest = np.arccos(np.clip(self.ratio * pull[:, 2] / np.hypot(pull[:, 0], pull[:, 1]), -1.0, 1.0))
        low, high = -widest, widest
        for seen_from in (eye[None], points):
            middle, half = self._facing(seen_from)
            off = np.remainder(middle - start + np.pi, 2.0 * np.pi) - np.pi
            low, high = np.maximum(low, off - half), np.minimum(high, off + half)
        return start, low, high

    def _facing(self, points: Floats) -> tuple[Floats, Floats]:
        """(azimuth, half width) of the part of the cone that points (n, 3) see; infinite where they see all of it."""
        x, y, z = points.T
        out = self.ratio * np.hypot(x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            half = np.arccos(np.clip(-z / out, -1.0, 1.0))
        return np.arctan2(y, x), np.where(z >= out, np.inf, half)

    def _shortest(self, eye: Floats, points: Floats, azimuth: Floats) -> tuple[Floats, Floats]:
        """The shortest way's point on the line down the cone at each azimuth (n, 3), and the way sideways (n, 3)."""
        cos, sin = np.cos(azimuth), np.sin(azimuth)
        line = np.stack([cos, sin, np.full_like(cos, -self.ratio)], axis=1) / np.hypot(1.0, self.ratio)
        near, far = (np.linalg.norm(np.cross(p, line), axis=1) for p in (eye[None], points))
        along = (line @ eye * far + np.sum(line * points, axis=1) * near) / (near + far)
        return along[:, None] * line, np.stack([-sin, cos, np.zeros_like(cos)], axis=1)

    def _slope(self, eye: Floats, points: Floats, azimuth: Floats) -> Floats:
        """How fast the way grows with a step sideways on the mirror."""
        at, sideways = self._shortest(eye, points, azimuth)
        pull = sum(to / np.linalg.norm(to, axis=1, keepdims=True) for to in (eye - at, points - at))
        return np.asarray(-np.sum(pull * sideways, axis=1), np.float64)
