"""Poses and velocities in the plane (REP-103: x forward, y left, yaw counter-clockwise; metres, radians)."""

from __future__ import annotations

import math
from dataclasses import dataclass


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi]."""
    return math.atan2(math.sin(angle), math.cos(angle))


@dataclass(frozen=True, slots=True)
class Pose2D:
    """Where frame `b` stands in frame `a`; name variables `a_from_b`, so that `a_from_b @ b_from_c` is `a_from_c`."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def __matmul__(self, other: Pose2D) -> Pose2D:
        x, y = self.transform(other.x, other.y)
        return Pose2D(x, y, wrap(self.yaw + other.yaw))

    def transform(self, x: float, y: float) -> tuple[float, float]:
        """The point (x, y) of the inner frame, in the outer one."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + c * x - s * y, self.y + s * x + c * y

    def inverse(self) -> Pose2D:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(-c * self.x - s * self.y, s * self.x - c * self.y, wrap(-self.yaw))

    def distance(self, other: Pose2D) -> float:
        """Metres between the two origins."""
        return math.hypot(other.x - self.x, other.y - self.y)

    def bearing(self, other: Pose2D) -> float:
        """Direction of the other's origin seen from here, relative to this heading, in [-pi, pi]."""
        return wrap(math.atan2(other.y - self.y, other.x - self.x) - self.yaw)


@dataclass(frozen=True, slots=True)
class Twist2D:
    """Forward speed (m/s) and turn rate (rad/s, counter-clockwise)."""

    vx: float = 0.0
    wz: float = 0.0


STOP = Twist2D()
