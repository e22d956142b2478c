"""Where a picture was taken, relative to an earlier one: direct alignment.

Gauss-Newton on the differences of contrast over turn, shift, and the nearness of every cell, which is eliminated
(Schur) with what is known of it. What is not known to be ceiling therefore says the more about the turn the less its
direction is that of the motion: the fields of expansion and contraction of the thesis come out by themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.alignment import Equations, Expected, Guess
from omnibotd.core.compass.contrast import Contrast
from omnibotd.core.compass.key_points import KeyPoints
from omnibotd.core.compass.nearness import Nearness, seen_from
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.frame import FloatImage

Floats = NDArray[np.float64]

_STEPS = 12
# Pixels: nothing is gained by a step that turns the horizon, or moves a ceiling a metre above, by less.
_STILL = 2e-3
# Fewer points than this, or so small a share of them in the picture, say nothing.
_FEWEST, _LEAST_SHARE = 150, 0.3
# A fix is believed from this correlation on.
GOOD_SCORE = 0.7


@dataclass(frozen=True, slots=True)
class Fix:
    """Where the robot is, seen from where the key view was taken.

    `score` is the correlation of what both show, -1 where they share nothing; `told` is what the picture says of every
    cell's excess (C,), and how surely (1/variance).
    """

    pose: Pose2D
    score: float
    told: tuple[Floats, Floats] | None = None

    @property
    def good(self) -> bool:
        return self.score >= GOOD_SCORE


NOT_SEEN = Fix(Pose2D(), -1.0)


class KeyLayer:
    """What was seen from one place at one resolution, and how near it was."""

    def __init__(self, points: KeyPoints, contrast: Contrast) -> None:
        """Of a picture that `contrast` made."""
        self.points, self.nearness = points, Nearness.guessed(points)
        self._contrast = contrast

    @classmethod
    def of(cls, picture: FloatImage, contrast: Contrast) -> KeyLayer | None:
        """None where there is too little to see."""
        points = KeyPoints.of(picture, contrast)
        return cls(points, contrast) if len(points) >= _FEWEST else None

    def inherit(self, older: KeyLayer, older_from_this: Pose2D) -> None:
        """Take over what an older one has learnt of the same things, seen from elsewhere (in heights)."""
        self.nearness.inherit(self.points, older.nearness, older.points, older_from_this, self._contrast)

    def learn(self, fix: Fix) -> None:
        """Of the nearness of things, by a picture that was located."""
        if fix.told:
            self.nearness.learn(*fix.told)

    def locate(self, picture: FloatImage, expected: Expected) -> Fix:
        """Where the picture was taken, from where this one was."""
        guess, nearness = Guess.first(expected), self.nearness.believed()
        score, near = -1.0, nearness.at(self.points)
        parallax = np.zeros_like(near)
        for _ in range(_STEPS):
            seen, inside = self._sampled(picture, guess.pose, near)
            if np.count_nonzero(inside) < _LEAST_SHARE * len(inside):
                return NOT_SEEN
            equations = Equations.of(self.points, near, guess.pose, seen - self.points.value, parallax, inside)
            solution = equations.solved(nearness.variance, expected, guess)
            parallax = equations.parallax * solution.correction[self.points.cell].astype(np.float32)
            score = _correlation(seen - parallax, self.points.value, equations.weight)
            guess = guess.stepped(solution.step)
            if np.abs(solution.step[:3]).max() * self._contrast.focal < _STILL:
                break
        correction, information = equations.told(solution.step)
        return Fix(guess.metric(expected), score, (nearness.excess + correction, information))

    def _sampled(self, picture: FloatImage, pose: Pose2D, near: FloatImage) -> tuple[FloatImage, NDArray[np.bool_]]:
        """The picture's contrast (N,) where it shows the points if taken at `pose`, and which are in it."""
        x, y, z = seen_from(pose, self.points, near)
        across = np.sqrt(x * x + y * y)
        zenith = np.arctan2(across, z)
        scale = np.float32(self._contrast.focal) * zenith / np.maximum(across, np.float32(1e-6))
        centre = np.float32(self._contrast.centre)
        # As one row: OpenCV takes rows of 32767 points at most, and a picture has a tenth of that.
        places = (centre + scale * x)[None], (centre + scale * y)[None]
        sampled = cv2.remap(picture, *places, cv2.INTER_LINEAR)[0]
        inside = cv2.remap(self._contrast.seen, *places, cv2.INTER_NEAREST)[0] > 0
        return np.asarray(sampled, np.float32), np.asarray(inside)


def _correlation(first: FloatImage, second: FloatImage, weight: FloatImage) -> float:
    weighted = weight * first
    energy = float(weighted @ first) * float((weight * second) @ second)
    return float(weighted @ second) / math.sqrt(energy + 1e-12)
