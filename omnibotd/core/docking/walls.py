"""The walls that a dock stands at: they fill up to three quarters of its view, and move by more than the ceiling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.ceiling_view import Layer
from omnibotd.core.docking.matching import Floats, Poses, Sample

Doubles = NDArray[np.float64]

# A dock in a niche has three walls; the fourth is the other side of a corridor.
_MOST = 4
# Nearness is tried in steps of 15 %: as exact as the middle layer tells.
_STEP = 1.15
_NEARNESS = (_STEP ** np.arange(16)).astype(np.float32)
# Directions and 1 / distance (in ceiling heights) of walls that are tried; alignment finds the rest.
_DIRECTIONS = np.arange(8) * (math.pi / 4.0)
_DISTANCES = (0.5, 0.65, 0.85, 1.1, 1.5, 2.0, 3.0, 5.0, 9.0)
# What a wall must take off the mean misfit to be worth trying.
_GAIN = 0.004


@dataclass(frozen=True, slots=True)
class Walls:
    """`towards` (m, 2) points to each wall and is 1 / its distance in ceiling heights; `information` (2m, 2m) on it.

    A ray q, at height 1, meets the ceiling or, sooner, the wall: there it is nearer by the factor q . towards.
    """

    towards: Doubles
    information: Doubles

    def __len__(self) -> int:
        return len(self.towards)

    def nearness(self, rays: Floats) -> Floats:
        """(n,) the ceiling's height over that of what each of `rays` (2, n) meets."""
        return np.asarray(self._factors(rays).max(0), np.float32)

    def met(self, rays: Floats) -> NDArray[np.intp]:
        """(n,) which wall each ray meets, from 1; 0 for the ceiling."""
        return np.asarray(self._factors(rays).argmax(0), np.intp)

    def moved(self, towards: Doubles) -> Walls:
        return Walls(towards, self.information)

    def with_wall(self, towards: Floats) -> Walls:
        """One more, of which nothing is known for sure."""
        size = 2 * len(self)
        information = np.zeros((size + 2, size + 2))
        information[:size, :size] = self.information
        return Walls(np.vstack([self.towards, towards]), information)

    def _factors(self, rays: Floats) -> Floats:
        ceiling = np.ones((1, rays.shape[1]), np.float32)
        return np.vstack([ceiling, self.towards.astype(np.float32) @ rays])


NO_WALLS = Walls(np.zeros((0, 2)), np.zeros((0, 0)))


class WallSearch:
    """Finds walls by what each point of the target would look like if it were nearer (a plane sweep)."""

    def __init__(self, sample: Sample) -> None:
        self._sample = sample
        across = [(math.cos(a) * near, math.sin(a) * near) for a in _DIRECTIONS for near in _DISTANCES]
        self._tried = np.array(across, np.float32)
        self._points = np.arange(sample.at.shape[1])
        # Where in a table of (steps, n) each wall finds its points.
        self._places = _steps(np.maximum(self._tried @ sample.at, 1.0)) * len(self._points) + self._points

    def more(self, layer: Layer, pose: Poses, known: Walls) -> Walls:
        """The walls known and those that explain the view from `pose` (3,) better; parallax must tell them apart."""
        misfit, walls = self._misfit(layer, pose), known
        every = np.arange(len(_NEARNESS))[:, None]
        # Behind the walls there are already nothing shows: each point is at least as near as they are.
        misfit = misfit[np.maximum(every, _steps(known.nearness(self._sample.at))), self._points]
        while len(walls) < _MOST:
            totals = misfit.ravel().take(self._places).sum(1)
            best = int(np.argmin(totals))
            if float(misfit[0].sum() - totals[best]) < _GAIN * len(self._points):
                break
            misfit = misfit[np.maximum(every, self._places[best] // len(self._points)), self._points]
            walls = walls.with_wall(self._tried[best])
        return walls

    def _misfit(self, layer: Layer, pose: Poses) -> Floats:
        """(steps, n) of each point at each nearness; brightness is standardised as if all were ceiling."""
        yaw, u, v = (np.float32(value) for value in pose)
        c, s, focal, centre = np.cos(yaw), np.sin(yaw), np.float32(layer.focal), np.float32((layer.size - 1) / 2.0)
        at, value = self._sample.at, self._sample.value
        off_u, off_v = at[0] - _NEARNESS[:, None] * u, at[1] - _NEARNESS[:, None] * v
        column, row = (c * off_u + s * off_v) * focal + centre, (c * off_v - s * off_u) * focal + centre
        found = cv2.remap(layer.picture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
        seen, current = found[..., 3] > 0.99, found[..., 0]
        if not seen[0].any():
            return np.full(seen.shape, self._sample.chance, np.float32)
        current = (current - current[0, seen[0]].mean()) / (current[0, seen[0]].std() + np.float32(1e-3))
        target = (value - value[seen[0]].mean()) / (value[seen[0]].std() + np.float32(1e-3))
        excess = (current - target) ** 2
        return np.where(seen, excess / (1.0 + excess), np.float32(self._sample.chance)).astype(np.float32)


def _steps(nearness: Floats) -> NDArray[np.intp]:
    """Which of the nearnesses tried comes closest."""
    return np.clip(np.rint(np.log(nearness) / math.log(_STEP)), 0, len(_NEARNESS) - 1).astype(np.intp)
