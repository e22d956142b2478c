"""Back from the dock to where it is approached from, by odometry and the dock's last known pose.

All poses are dock_from_base.
"""

from __future__ import annotations

import math

from omnibotd.core.docking.approach import Limits, Move, SmoothApproach
from omnibotd.core.docking.sightings import agree
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap

# Half a metre: far enough to straighten out in; missed by 0.25 m it is still well within a fix's reach.
STAGING_DISTANCE = 0.5
STAGING = Pose2D(-STAGING_DISTANCE, 0.0, 0.0)
# Backwards the robot is blind.
SPEED = 0.1
# A dock may have cheeks: from within it (m, rad) no turn before the robot is out.
_IN_DOCK, _IN_DOCK_YAW = 0.2, math.radians(30.0)
# What a bumper touches is left by so much (m) before anything else.
_BUMPED = 0.1
# As near to the staging pose as the approach cares (m, rad).
_NEAR, _NEAR_YAW = 0.08, math.radians(10.0)


def staging_pose(map_from_dock: Pose2D) -> Pose2D:
    """Where to start docking: half a metre behind the dock along its own x, facing as it does.

    Contacts and bumpers are in front and a dock stands against a wall: from here the approach is straight ahead, over
    floor that was driven when the dock was saved, under nearly the same piece of ceiling.
    """
    return map_from_dock @ STAGING


def straight_back(start: Pose2D, here: Pose2D, speed: float) -> Twist2D:
    """Backwards along the line through `start` (any one frame for both), steered by what odometry feels."""
    off = start.inverse() @ here
    wanted = min(max(2.0 * off.y, -0.2), 0.2)
    return Twist2D(-speed, min(max(1.5 * (wanted - off.yaw), -0.3), 0.3))


class Retreat:
    """Straight back while in the dock, then a curve to the staging pose and a turn to its heading."""

    def __init__(self, limits: Limits, start: Pose2D, *, bumped: bool) -> None:
        self._limits = limits
        self._start = start
        inside = agree(start, Pose2D(), _IN_DOCK, _IN_DOCK_YAW)
        self._straight = start.x - STAGING.x if inside else _BUMPED if bumped else 0.0
        self._curve: SmoothApproach | None = None
        self._turn: Move | None = None

    def twist(self, pose: Pose2D, dt: float, *, bumped: bool) -> Twist2D | None:
        """None once at the staging pose, or where something is in the way; `dt` is how long a command holds."""
        if pose.distance(self._start) < self._straight:
            return straight_back(self._start, pose, min(SPEED, self._limits.linear))
        if agree(pose, STAGING, _NEAR, _NEAR_YAW):
            return None
        if self._turn is None:
            curve = self._curved(pose)
            if curve is not None:
                return None if bumped and curve.vx > 0.0 else curve
            self._turn = Move(self._limits, pose, STAGING.yaw, 1.0)
            return STOP
        return self._turn.twist(pose, dt)

    def _curved(self, pose: Pose2D) -> Twist2D | None:
        """Towards the staging pose, at the pace of somebody who can't see; None once there, but for the heading."""
        ahead = STAGING.inverse() @ pose
        if pose.distance(STAGING) < _NEAR:
            return None
        if self._curve is None:
            slow = Limits(min(SPEED, self._limits.linear), self._limits.angular, _NEAR, _NEAR_YAW)
            self._curve = SmoothApproach(slow, ahead)
        return self._curve.twist(ahead)


class Sidestep:
    """A turn, a straight drive and a turn to a pose some decimetres away."""

    def __init__(self, limits: Limits, start: Pose2D, goal: Pose2D) -> None:
        self._limits = limits
        aim = math.atan2(goal.y - start.y, goal.x - start.x)
        if abs(wrap(aim - start.yaw)) > math.pi / 2.0:
            aim = wrap(aim + math.pi)
        self._goals: list[float | tuple[float, float]] = [aim, (goal.x, goal.y), goal.yaw]
        self._move: Move | None = None

    def twist(self, pose: Pose2D, dt: float) -> Twist2D | None:
        """None once there, as far as odometry tells."""
        if self._move is not None:
            twist = self._move.twist(pose, dt)
            if twist is not None:
                return twist
        if not self._goals:
            return None
        self._move = Move(self._limits, pose, self._goals.pop(0), 1.0)
        return STOP
