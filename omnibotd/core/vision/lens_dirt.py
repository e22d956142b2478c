"""Dirt on the lens, and whatever else stands still in the picture while the robot turns: found, and left out of views.

A smudge shows its edges in every frame, at the same bearing from the base. To a robot in the dark they were half of
what it saw: by night with a tenth of the lens covered, a right pose correlated at 0.28, and at 0.42 without them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.view import RINGS, SECTORS, View

# Headings are told apart in so many parts of a turn; in each, a cell's mean is over this many frames, so far apart
# (m, rad).
_HEADINGS, _FRAMES = 12, 10
_APART, _TURNED = 0.1, 0.1
# A cell is dirty that differs by so much from its ring, and the same way at all headings, from so many of them on: by
# chance four of the 1024 cells do.
_DIFFERENT, _ENOUGH = 0.1, 9


class LensDirt:
    """What one camera's frames have in common at all headings."""

    def __init__(self, seen: NDArray[np.bool_]) -> None:
        """`seen` (RINGS, SECTORS) are the cells that the camera sees."""
        self._seen = seen
        self._cells = np.maximum(seen.sum(1), 1)
        self._means = np.zeros((_HEADINGS, RINGS, SECTORS), np.float32)
        self._frames = np.zeros(_HEADINGS, np.intp)
        self._taken: Pose2D | None = None
        self.dirty: NDArray[np.bool_] = np.zeros((RINGS, SECTORS), np.bool_)

    def without(self, texture: View, odom_from_base: Pose2D) -> View:
        """The texture (RINGS, SECTORS) of a frame taken there, with its ring's mean where dirt is."""
        self._learn(texture, odom_from_base)
        if not self.dirty.any():
            return texture
        clean = self._seen & ~self.dirty
        mean = (texture * clean).sum(1) / np.maximum(clean.sum(1), 1)
        return np.where(self.dirty, mean[:, None], texture).astype(np.float32)

    def _learn(self, texture: View, odom_from_base: Pose2D) -> None:
        last, yaw = self._taken, odom_from_base.yaw
        if last is not None and last.distance(odom_from_base) < _APART and abs(wrap(yaw - last.yaw)) < _TURNED:
            return
        self._taken = odom_from_base
        part = int(yaw % math.tau / math.tau * _HEADINGS) % _HEADINGS
        self._frames[part] = min(self._frames[part] + 1, _FRAMES)
        different = (texture - (texture.sum(1) / self._cells)[:, None]) * self._seen
        self._means[part] += (different - self._means[part]) / self._frames[part]
        known = self._means[self._frames > 0]
        if len(known) >= _ENOUGH:
            self.dirty = (known.min(0) > _DIFFERENT) | (known.max(0) < -_DIFFERENT)
