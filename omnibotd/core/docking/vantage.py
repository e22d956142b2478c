"""Where else to look from, where the dock was not seen from here: nearer, by the map's word, or turned a little.

The dock's own view is known best from near by; dirt on the lens hides another part of the ceiling at another heading.
"""

from __future__ import annotations

import math

from omnibotd.core.docking.approach import Limits, Move, SmoothApproach
from omnibotd.core.docking.retreat import SPEED
from omnibotd.core.geometry import Pose2D, Twist2D

# No nearer than this (m) to a dock that was not seen: the map's word is good to a tenth, and a base has a nose.
_NEAREST = 0.25
# Enough that what dirt hides is seen, and three of them still look one way (rad).
_TURN = math.radians(40.0)


class Nearer:
    """Half the way to the dock; `start` and all poses are dock_from_base, as the map tells."""

    def __init__(self, limits: Limits, start: Pose2D) -> None:
        slow = Limits(min(SPEED, limits.linear), limits.angular, limits.position_tolerance, limits.yaw_tolerance)
        self._approach = SmoothApproach(slow, start)
        self._wanted = max(_NEAREST, math.hypot(start.x, start.y) / 2.0)

    @staticmethod
    def worth(pose: Pose2D) -> bool:
        """Whether there is a way to go."""
        return math.hypot(pose.x, pose.y) > _NEAREST + 0.05

    def twist(self, pose: Pose2D, dt: float, *, bumped: bool) -> Twist2D | None:
        """None once there, or where something is in the way."""
        return None if bumped or math.hypot(pose.x, pose.y) <= self._wanted else self._approach.twist(pose)


class Turned:
    """A turn on the spot; poses in any frame that stands still."""

    def __init__(self, limits: Limits, start: Pose2D) -> None:
        self._move = Move(limits, start, start.yaw + _TURN, 1.0)

    def twist(self, pose: Pose2D, dt: float, *, bumped: bool) -> Twist2D | None:
        """None once done; `dt` is how long a command holds."""
        return self._move.twist(pose, dt)
