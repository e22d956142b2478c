"""How to drive to the dock: a smooth approach, then small turns and straight moves, each measured at rest.

All poses are dock_from_base: the goal is the origin, heading 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from omnibotd.core.geometry import Pose2D, Twist2D, wrap

# Slower than this the wheels of cheap bases stall or cog (m/s; rad/s is the same at the rim of a 0.25 m track).
MIN_LINEAR, MIN_ANGULAR = 0.015, 0.08
# The smooth approach ends here, in metres: nearer, the direction to the goal is mostly noise.
_CAPTURE = 0.02
# Nearer than this a goal that lies abeam was passed; the trim does the rest.
_PASSED = 0.10
# Polar parking law (Astolfi 1999): stable for K_DISTANCE > 0, K_FINAL > 0, K_AIM > K_DISTANCE.
_K_DISTANCE, _K_AIM, _K_FINAL = 0.6, 1.8, 0.6
_CREEP = 0.02
# Beyond this the curve to the final heading would swing away from the dock first.
_MAX_SWING = 1.4
# A move this small (rad, m) is one measured pulse; a larger one is steered by odometry.
_TURN_PULSE, _DRIVE_PULSE = 0.05, 0.01
# Command to motion and back takes about this long: a steered move stops this much early (s).
_LEAD = 0.15
_K_TURN, _K_DRIVE = 2.0, 1.0
# A turn this small moves the base by less than a millimetre; and how far back a dock abeam is approached from (m).
_SMALL_TURN, _BACK_OFF = math.radians(20.0), 0.08
# A pulse that moved nothing is repeated stronger, up to this (a base with much stiction).
_BOOST, _MAX_BOOST = 1.5, 4.0


@dataclass(frozen=True, slots=True)
class Limits:
    """Highest speeds (m/s, rad/s) and what counts as there (m, rad)."""

    linear: float
    angular: float
    position_tolerance: float
    yaw_tolerance: float

    def reached(self, pose: Pose2D) -> bool:
        return self.near(pose) and abs(pose.yaw) <= self.yaw_tolerance

    def near(self, pose: Pose2D) -> bool:
        return math.hypot(pose.x, pose.y) <= self.position_tolerance


class SmoothApproach:
    """Polar parking controller, forwards or backwards, whichever is the shorter turn at the start."""

    def __init__(self, limits: Limits, start: Pose2D) -> None:
        self._limits = limits
        self._sign = 1.0 if abs(_aim(start)) <= math.pi / 2.0 else -1.0

    def twist(self, pose: Pose2D) -> Twist2D | None:
        """None once the dock is within 2 cm, or was passed close by."""
        distance = math.hypot(pose.x, pose.y)
        aim, final = _aim(pose), wrap(-math.atan2(-pose.y, -pose.x))
        if self._sign < 0.0:
            aim, final = wrap(aim + math.pi), wrap(final + math.pi)
        if distance < _CAPTURE or (distance < _PASSED and abs(aim) > math.pi / 2.0):
            return None
        speed = min(self._limits.linear, _K_DISTANCE * distance + _CREEP) * max(0.0, math.cos(aim))
        # The final heading counts less near the goal, where it would only shake the robot.
        weight = _K_FINAL * min(1.0, distance / _PASSED)
        turn = _K_AIM * aim - weight * _clip(final, _MAX_SWING)
        return Twist2D(self._sign * speed, _clip(turn, self._limits.angular))


class Move:
    """One turn on the spot to a heading, or one straight drive until a point is abeam; begun at rest."""

    def __init__(self, limits: Limits, start: Pose2D, goal: float | tuple[float, float], boost: float) -> None:
        """`goal`: the heading to turn to, or the point to drive to; `boost` strengthens a pulse."""
        self._goal = goal
        self._turns = isinstance(goal, float)
        self._slowest = MIN_ANGULAR if self._turns else MIN_LINEAR
        self._fastest = limits.angular if self._turns else limits.linear
        self._wanted = self._remaining(start)
        self._boost = boost
        self._pulse = abs(self._wanted) <= (_TURN_PULSE if self._turns else _DRIVE_PULSE)
        self._ticks: int | None = None
        self._pulse_speed = 0.0

    def twist(self, pose: Pose2D, dt: float) -> Twist2D | None:
        """None once done; `dt` is how long a command holds."""
        speed = self._pulsed(dt) if self._pulse else self._steered(pose)
        if speed is None:
            return None
        return Twist2D(0.0, speed) if self._turns else Twist2D(speed, 0.0)

    def stalled(self, pose: Pose2D) -> bool:
        """Whether less than a third of what was wanted has happened."""
        return self._remaining(pose) * math.copysign(1.0, self._wanted) > 0.67 * abs(self._wanted)

    def _remaining(self, pose: Pose2D) -> float:
        if isinstance(self._goal, float):
            return wrap(self._goal - pose.yaw)
        dx, dy = self._goal[0] - pose.x, self._goal[1] - pose.y
        return dx * math.cos(pose.yaw) + dy * math.sin(pose.yaw)

    def _steered(self, pose: Pose2D) -> float | None:
        left = self._remaining(pose) * math.copysign(1.0, self._wanted)
        speed = min(max((_K_TURN if self._turns else _K_DRIVE) * left, self._slowest), self._fastest)
        return None if left <= _LEAD * speed else math.copysign(speed, self._wanted)

    def _pulsed(self, dt: float) -> float | None:
        """As many whole ticks as the slowest useful speed needs, at the speed that then covers what is wanted."""
        if self._ticks is None:
            self._ticks = max(1, int(abs(self._wanted) / (self._slowest * dt)))
            speed = max(abs(self._wanted) / (self._ticks * dt), self._slowest) * self._boost
            self._pulse_speed = math.copysign(min(speed, self._fastest), self._wanted)
        if self._ticks == 0:
            return None
        self._ticks -= 1
        return self._pulse_speed


class Trim:
    """From each pose measured at rest, the next single move towards the dock: turns and straight drives.

    Only small turns: a turn by 90 degrees and back displaces a cheap base (unequal wheels) by more than the error it
    is to mend. A dock that lies abeam is therefore approached again from a little further back.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._move: Move | None = None
        self._boost = 1.0
        self.rounds = 0

    def plan(self, pose: Pose2D) -> None:
        """Choose the next move from `pose`, measured at rest and not yet at the dock."""
        stalled = self._move is not None and self._move.stalled(pose)
        self._boost = min(self._boost * _BOOST, _MAX_BOOST) if stalled else 1.0
        self._move = Move(self._limits, pose, self._goal(pose), self._boost)
        self.rounds += 1

    def twist(self, pose: Pose2D, dt: float) -> Twist2D | None:
        """The planned move's command, None once it is done (or none is planned)."""
        return None if self._move is None else self._move.twist(pose, dt)

    def _goal(self, pose: Pose2D) -> float | tuple[float, float]:
        """Heading to turn to next, or point to drive to."""
        if self._limits.near(pose):
            return 0.0
        aim = _aim(pose)
        if abs(aim) > math.pi / 2.0:
            aim = wrap(aim + math.pi)
        distance = math.hypot(pose.x, pose.y)
        if distance * abs(math.sin(aim)) < self._limits.position_tolerance / 2.0:
            return 0.0, 0.0
        if abs(aim) < _SMALL_TURN:
            return wrap(pose.yaw + aim)
        if abs(pose.yaw) > _SMALL_TURN:
            return 0.0
        return -max(_BACK_OFF, distance / math.tan(_SMALL_TURN / 2.0)), pose.y


def _aim(pose: Pose2D) -> float:
    """Bearing of the dock from the robot's heading."""
    return wrap(math.atan2(-pose.y, -pose.x) - pose.yaw)


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
