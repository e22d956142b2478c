"""Something in the way: how it is noticed, and the step back from it."""

from __future__ import annotations

from omnibotd.core.decision import Observation
from omnibotd.core.geometry import Twist2D
from omnibotd.core.safety import RANGE_MARGIN

# What stands nearer than this ahead (m) for so long (s) while the robot wants to go on is a bump without contact.
TOO_NEAR, TOO_LONG = 0.12, 1.0
BACK_OFF = 0.15  # m straight back after a bump
BACK_OFF_TIME = 3.0  # s; twice what it takes: something stands behind as well
BACKWARDS = Twist2D(-0.1, 0.0)


class Contact:
    """Notices what is touched, an edge, and what stands a hand's breadth ahead and does not go away."""

    def __init__(self) -> None:
        self._near_since: float | None = None

    def blocks(self, seen: Observation, way: float) -> bool:
        """Whether there is no going on; `way` is how many metres ahead the robot wants to get, 0 when it does not."""
        ahead = seen.range_ahead
        if ahead is None or ahead > TOO_NEAR or way <= max(ahead - RANGE_MARGIN, 0.0):
            self._near_since = None
        elif self._near_since is None:
            self._near_since = seen.stamp
        standing = self._near_since is not None and seen.stamp - self._near_since >= TOO_LONG
        return standing or seen.bumper_left or seen.bumper_right or seen.cliff


class BackingOff:
    """Straight back from where it begins; the floor there has just been driven."""

    def __init__(self, seen: Observation) -> None:
        self._since, self._start = seen.stamp, seen.odom_from_base

    def over(self, seen: Observation) -> bool:
        far = self._start.distance(seen.odom_from_base) >= BACK_OFF
        return far or seen.stamp - self._since > BACK_OFF_TIME
