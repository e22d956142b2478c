"""The four things that the robot can do (thesis §6.4.4)."""

from __future__ import annotations

import math
from enum import IntEnum

from omnibotd.core.geometry import Pose2D

STRIDE = 0.15  # m
TURN = math.radians(45.0)


class Action(IntEnum):
    """A stride ahead or back, a turn to the left or right."""

    FORWARD = 0
    BACKWARD = 1
    LEFT = 2
    RIGHT = 3

    @property
    def inverse(self) -> Action:
        """What undoes it: the action of a link taken the other way."""
        return Action(self ^ 1)

    @property
    def move(self) -> Pose2D:
        """In the base frame before it."""
        return _MOVES[self]


_MOVES = (Pose2D(STRIDE), Pose2D(-STRIDE), Pose2D(yaw=TURN), Pose2D(yaw=-TURN))
