"""What perception tells the control tick: immutable, with the frame's own stamp and the odometry at that stamp."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D


@dataclass(frozen=True, slots=True)
class PlaceEstimate:
    """Where the map says the robot was when the frame came.

    `confidence` in [0, 1] is the belief that the pose is right (within 0.25 m); `sigma` (m) its spread when it is.
    `score` is the match with the best node in [-1, 1], `margin` its lead over the best node more than 0.5 m away.
    """

    stamp: float
    odom_from_base: Pose2D
    map_from_base: Pose2D
    confidence: float
    sigma: float
    score: float
    margin: float
    node: int


class Verdict(StrEnum):
    """How far a homing estimate can be trusted."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class HomingEstimate:
    """Where the base stood relative to the pose at which the dock's snapshot was taken (thesis: homing vector).

    `score` is the correlation of the views in [-1, 1], `margin` the lead over the next best pose (1 where none was
    tried). `covariance` (3, 3) of dock_from_base's (x, y, yaw), m and rad; None from a method that knows of none.
    """

    stamp: float
    odom_from_base: Pose2D
    dock_from_base: Pose2D
    score: float
    margin: float
    verdict: Verdict
    covariance: NDArray[np.float64] | None = field(default=None, compare=False)
