"""Differential drive: between the robot's velocity and its two wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass

from omnibotd.core.geometry import Pose2D, Twist2D


@dataclass(frozen=True, slots=True)
class DifferentialDrive:
    """Two driven wheels on one axle; `wheel_radius` is the mean of both, `wheel_ratio` left over right; metres."""

    wheel_radius: float
    wheel_separation: float
    wheel_ratio: float = 1.0

    @property
    def radii(self) -> tuple[float, float]:
        """Of the left and the right wheel."""
        right = 2.0 * self.wheel_radius / (1.0 + self.wheel_ratio)
        return self.wheel_ratio * right, right

    def wheel_speeds(self, twist: Twist2D) -> tuple[float, float]:
        """Angular speeds (left, right) of the wheels, rad/s."""
        turn = twist.wz * self.wheel_separation / 2.0
        left, right = self.radii
        return (twist.vx - turn) / left, (twist.vx + turn) / right

    def displacement(self, left: float, right: float) -> Pose2D:
        """Motion of the base when its wheels have turned by `left` and `right` radians on one arc."""
        left_radius, right_radius = self.radii
        rolled_left, rolled_right = left * left_radius, right * right_radius
        arc = (rolled_left + rolled_right) / 2.0
        yaw = (rolled_right - rolled_left) / self.wheel_separation
        # Chord of the arc: sin(yaw/2)/(yaw/2), which is 1 for a straight line.
        chord = arc if abs(yaw) < 1e-9 else arc * math.sin(yaw / 2.0) / (yaw / 2.0)
        return Pose2D(chord * math.cos(yaw / 2.0), chord * math.sin(yaw / 2.0), yaw)
