"""Wheel odometry: encoder counts in, the pose of the base in the odom frame out."""

from __future__ import annotations

import bisect
import math
from collections import deque

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.kinematics import DifferentialDrive

# Frames arrive at most a second late (then the camera counts as stalled); telemetry comes at 50-100 Hz.
HISTORY = 200


class WheelOdometry:
    """Integrates wheel counts; remembers the last seconds, so that a frame can be given the pose at its stamp."""

    def __init__(self, drive: DifferentialDrive) -> None:
        self._drive = drive
        self._ticks: tuple[int, int] | None = None
        self._history: deque[tuple[float, Pose2D]] = deque(maxlen=HISTORY)
        self.odom_from_base = Pose2D()
        self.distance = 0.0

    def rebase(self) -> None:
        """Forget the counts, not the pose: the base restarted or was away, its encoders mean nothing now."""
        self._ticks = None

    def update(self, stamp: float, left_ticks: int, right_ticks: int, ticks_per_rev: float) -> Pose2D:
        """Take encoder counts (unwrapped) read at `stamp`; returns odom_from_base."""
        if self._ticks is not None:
            scale = 2.0 * math.pi / ticks_per_rev
            left = (left_ticks - self._ticks[0]) * scale
            right = (right_ticks - self._ticks[1]) * scale
            step = self._drive.displacement(left, right)
            self.odom_from_base = self.odom_from_base @ step
            self.distance += math.hypot(step.x, step.y)
        self._ticks = (left_ticks, right_ticks)
        self._history.append((stamp, self.odom_from_base))
        return self.odom_from_base

    def at(self, stamp: float) -> Pose2D:
        """odom_from_base at `stamp`, interpolated; the oldest or newest known pose outside the history."""
        if not self._history:
            return self.odom_from_base
        after = bisect.bisect_left(self._history, stamp, key=lambda entry: entry[0])
        if after == 0:
            return self._history[0][1]
        if after == len(self._history):
            return self._history[-1][1]
        (t0, a), (t1, b) = self._history[after - 1], self._history[after]
        share = (stamp - t0) / (t1 - t0) if t1 > t0 else 1.0
        return Pose2D(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), wrap(a.yaw + share * wrap(b.yaw - a.yaw)))
