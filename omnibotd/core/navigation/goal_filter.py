"""Joins place estimates and odometry into one pose in the map (thesis §6.5.5, Eqs 6.10-6.17).

The thesis filters the offset to the goal with one Kalman filter an axis. The offset is the goal minus the robot, so
filtering the robot's own pose is the same filter with the goal taken out: it then serves every goal, and the heading.
"""

from __future__ import annotations

import math

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import PlaceEstimate

# Growth of variance while driving: 2 % of the distance (thesis §6.5.5, per axis, metres) and 15 % of the angle turned:
# views tell the heading so well that nothing is lost by trusting wheels nobody calibrated even less.
POSITION_DRIFT = 0.02
HEADING_DRIFT = 0.15
# Successive errors are correlated: without a floor the filter would soon trust nothing but itself.
MIN_POSITION_SIGMA = 0.01
MIN_HEADING_SIGMA = math.radians(0.3)
HEADING_SIGMA = math.radians(1.0)  # of one place estimate
# An estimate this many sigmas off is a wrong place or a carried robot; three in a row that agree mean the latter.
GATE = 5.0
GATE_FLOOR = 0.15  # m; odometry slips by more than its model says
AGREEING = 3


class GoalFilter:
    """Pose in the map between and across place estimates; `confidence` is that of the last estimate taken in."""

    def __init__(self) -> None:
        self.map_from_base: Pose2D | None = None
        self.confidence = 0.0
        self.variance = 1.0
        self._heading_variance = 1.0
        self._odom_from_base: Pose2D | None = None
        self._rejected: list[Pose2D] = []

    def predict(self, odom_from_base: Pose2D) -> Pose2D | None:
        """Move with the odometry (Eqs 6.10-6.13); returns map_from_base, None while unknown."""
        if self._odom_from_base is not None and self.map_from_base is not None:
            step = self._odom_from_base.inverse() @ odom_from_base
            self.map_from_base = self.map_from_base @ step
            moved = math.hypot(step.x, step.y)
            self.variance += (POSITION_DRIFT * moved) ** 2 + POSITION_DRIFT**2 * moved * 0.1
            self._heading_variance += (HEADING_DRIFT * step.yaw) ** 2
        self._odom_from_base = odom_from_base
        return self.map_from_base

    def update(self, place: PlaceEstimate, min_confidence: float) -> None:
        """Take in one place estimate (Eqs 6.14-6.17), carried by odometry from its own stamp to the last prediction."""
        self.confidence = place.confidence
        if place.confidence < min_confidence or self._odom_from_base is None:
            return
        measured = place.map_from_base @ (place.odom_from_base.inverse() @ self._odom_from_base)
        noise = max(place.sigma, MIN_POSITION_SIGMA) ** 2
        if self.map_from_base is None or self._carried(measured, noise):
            self.map_from_base, self.variance, self._heading_variance = measured, noise, HEADING_SIGMA**2
            self._rejected.clear()
        elif not self._rejected:
            self._blend(self.map_from_base, measured, noise)

    def _carried(self, measured: Pose2D, noise: float) -> bool:
        """Remember an estimate outside the gate; True once enough of them in a row agree with each other."""
        assert self.map_from_base is not None
        gate = max(GATE_FLOOR, GATE * math.sqrt(self.variance + noise))
        if self.map_from_base.distance(measured) < gate:
            self._rejected.clear()
            return False
        if self._rejected and self._rejected[-1].distance(measured) > GATE_FLOOR:
            self._rejected.clear()
        self._rejected.append(measured)
        return len(self._rejected) >= AGREEING

    def _blend(self, predicted: Pose2D, measured: Pose2D, noise: float) -> None:
        gain = self.variance / (self.variance + noise)
        turn_gain = self._heading_variance / (self._heading_variance + HEADING_SIGMA**2)
        self.map_from_base = Pose2D(
            predicted.x + gain * (measured.x - predicted.x),
            predicted.y + gain * (measured.y - predicted.y),
            wrap(predicted.yaw + turn_gain * wrap(measured.yaw - predicted.yaw)),
        )
        self.variance = max(self.variance * (1.0 - gain), MIN_POSITION_SIGMA**2)
        self._heading_variance = max(self._heading_variance * (1.0 - turn_gain), MIN_HEADING_SIGMA**2)
