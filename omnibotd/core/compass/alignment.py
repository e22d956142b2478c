"""The equations of one step of direct alignment: pose, height of the ceiling, and the nearness of every cell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.key_points import KeyPoints
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.frame import FloatImage

Floats = NDArray[np.float64]

# Residuals beyond two robust standard deviations count less (Cauchy); noise is never less than this.
_ROBUST, _QUIET = 2.0, 1e-3
# Neighbouring points share their noise, and what the equations leave out is none: counted in full, they outvote walls
# that have not been learnt yet. Tried from 0.02 to 1 on simulated rooms and on the real lamp grid.
_WORTH = np.float32(0.6)


@dataclass(frozen=True, slots=True)
class Expected:
    """Where to begin; where the robot should be, and how far it may be off (one standard deviation: m, rad).

    `height`: m from camera to ceiling, which may be wrong by the share `height_error`.
    """

    start: Pose2D
    pose: Pose2D
    shift: float
    turn: float
    height: float
    height_error: float


@dataclass(frozen=True, slots=True)
class Guess:
    """So far: the pose in heights, and the logarithm of the ceiling's height over that expected."""

    pose: Pose2D
    stretch: float

    @classmethod
    def first(cls, expected: Expected) -> Guess:
        return cls(in_heights(expected.start, expected.height), 0.0)

    def stepped(self, step: Floats) -> Guess:
        """With a step (x, y, turn, stretch) taken, the pose's before the pose."""
        return Guess(Pose2D(*step[:3]) @ self.pose, self.stretch + float(step[3]))

    def metric(self, expected: Expected) -> Pose2D:
        """In metres."""
        return in_heights(self.pose, 1.0 / (expected.height * math.exp(self.stretch)))

    def apart(self, expected: Expected) -> tuple[Floats, Floats, Floats]:
        """What was expected (x, y, yaw, stretch): its change with a step (4, 4), the rest (4,), and 1/variance (4,)."""
        height, pose = expected.height * math.exp(self.stretch), self.pose
        # A turn about where the key view was taken carries the pose round.
        moves = np.eye(4)
        moves[0] = height * np.array([1.0, 0.0, -pose.y, pose.x])
        moves[1] = height * np.array([0.0, 1.0, pose.x, pose.y])
        rest = (
            expected.pose.x - height * pose.x,
            expected.pose.y - height * pose.y,
            wrap(expected.pose.yaw - pose.yaw),
            -self.stretch,
        )
        sure = np.array([expected.shift, expected.shift, expected.turn, expected.height_error]) ** -2.0
        return moves, np.array(rest), sure


def in_heights(pose: Pose2D, height: float) -> Pose2D:
    """With lengths over `height`."""
    return Pose2D(pose.x / height, pose.y / height, pose.yaw)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A step (x, y, turn, stretch), and each cell's correction of its nearness (C,)."""

    step: Floats
    correction: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Of one step: sums of weighted products over all points, and over those of each of C cells.

    `parallax` (N,) is how contrast changes with the nearness of what is seen.
    """

    weight: FloatImage
    parallax: FloatImage
    normal: Floats  # (3, 3) of the step
    pull: Floats  # (3,)
    cell_normal: Floats  # (C,) of each cell's nearness
    cell_pull: Floats  # (C,)
    mixed: Floats  # (C, 3)

    @classmethod
    def of(
        cls,
        points: KeyPoints,
        near: FloatImage,
        pose: Pose2D,
        difference: FloatImage,
        explained: FloatImage,
        inside: NDArray[np.bool_],
    ) -> Equations:
        """`difference` (N,) of contrast, of which `explained` is what the cells' corrections account for so far."""
        weight = _weights(difference - explained, inside)
        parallax = points.along_x * np.float32(pose.x) + points.along_y * np.float32(pose.y)
        jacobian = np.stack([near * points.along_x, near * points.along_y, points.along_turn])
        weighted, heavy = jacobian * weight, weight * parallax
        return cls(
            weight,
            parallax,
            (weighted @ jacobian.T).astype(np.float64),
            (weighted @ difference).astype(np.float64),
            np.add.reduceat(heavy * parallax, points.first).astype(np.float64),
            np.add.reduceat(heavy * difference, points.first).astype(np.float64),
            np.add.reduceat(weighted * parallax, points.first, axis=1).T.astype(np.float64),
        )

    def solved(self, variance: Floats, expected: Expected, guess: Guess) -> Solution:
        """The step from `guess`, with what is known of each cell's nearness (`variance`) and expected of the pose."""
        cells = self.cell_normal + 1.0 / variance
        normal, pull = np.zeros((4, 4)), np.zeros(4)
        normal[:3, :3] = self.normal - self.mixed.T @ (self.mixed / cells[:, None])
        pull[:3] = self.pull - self.mixed.T @ (self.cell_pull / cells)
        moves, off, sure = guess.apart(expected)
        normal += moves.T @ (sure[:, None] * moves)
        pull += moves.T @ (sure * off)
        step = np.asarray(np.linalg.solve(normal, pull), np.float64)
        return Solution(step, (self.cell_pull - self.mixed @ step[:3]) / cells)

    def told(self, step: Floats) -> tuple[Floats, Floats]:
        """Each cell's correction (C,) by this picture alone, and how much that is worth (1/variance)."""
        return (self.cell_pull - self.mixed @ step[:3]) / np.maximum(self.cell_normal, 1e-9), self.cell_normal


def _weights(residual: FloatImage, inside: NDArray[np.bool_]) -> FloatImage:
    """Of each point: over the variance of the noise, less for outliers (Cauchy), none outside the picture."""
    noise = np.float32(1.4826 * float(np.median(np.abs(residual[inside]))) + _QUIET)
    relative = residual / (np.float32(_ROBUST) * noise)
    return np.asarray(_WORTH * inside / ((1.0 + relative * relative) * (noise * noise)), np.float32)
