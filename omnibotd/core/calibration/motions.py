"""Motions by which the robot calibrates itself, as jobs: turns on the spot, straight drives out and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap
from omnibotd.core.safety import Limits, danger, stopping_speed

# Slow enough for an exposure of 15 ms to blur by one pixel at most, fast enough to be done in a minute (rad/s, m/s).
TURN_RATE, DRIVE_SPEED = 0.5, 0.2
# Braking well within what the gate allows keeps the wheels from slipping.
_BRAKING = 0.5
# Below this share of full speed nothing moves on some floors.
_SLOWEST = 0.1
# Stands so long (s) before and after each move: the camera's picture and the wheels' counts then belong together.
_REST = 0.7
# Wheels may be wrong by a tenth, and the turn must close all the same.
_SPIN = 1.12 * 2.0 * math.pi
_TURNS_EACH_WAY, _DRIVES = 3, 5
# Longer drives tell more and need more room (m); the whole way must be free, ahead of where it starts.
LEG = 1.2
# A move that gets no further for so long (s) is stuck: a wheel turns on a carpet's edge, or not at all.
_STUCK = 5.0


class State(StrEnum):
    """What the robot is doing."""

    RESTING = "RESTING"
    TURNING = "TURNING"
    DRIVING = "DRIVING"


@dataclass(frozen=True, slots=True)
class Move:
    """A turn on the spot (rad, counter-clockwise) or a straight drive (m, ahead), as the wheels count it."""

    state: State
    amount: float


class CalibrationMotion:
    """Makes its moves one after another, standing before and after each; ends at whatever is in the way."""

    def __init__(self, limits: Limits, moves: Sequence[Move]) -> None:
        self._limits = limits
        self._moves = tuple(moves)
        self._done = 0
        self._gone = self._farthest = 0.0  # of the move under way
        self._last: Pose2D | None = None
        self._rested_since = self._advanced_at = math.nan
        self._outcome: Outcome | None = None

    @property
    def progress(self) -> float:
        """The share done, in [0, 1]."""
        if self._done == len(self._moves):
            return 1.0
        under_way = min(1.0, max(0.0, self._gone / self._moves[self._done].amount))
        return (self._done + under_way) / len(self._moves)

    def step(self, seen: Observation) -> Decision:
        """One tick. After the outcome it goes on returning it, standing still."""
        if self._outcome is None:
            self._outcome = danger(seen) or _in_the_way(seen)
        if self._outcome is not None:
            return Decision(State.RESTING, STOP, self._outcome)
        self._follow(seen)
        if self._rests(seen):
            return Decision(State.RESTING, STOP, self._outcome)
        return self._move(seen, self._moves[self._done])

    def _follow(self, seen: Observation) -> None:
        """How far the move under way has gone."""
        if self._last is None:
            self._rested_since = seen.stamp
        elif self._done < len(self._moves):
            turns = self._moves[self._done].state is State.TURNING
            self._gone += _turned(self._last, seen) if turns else _driven(self._last, seen)
        self._last = seen.odom_from_base

    def _rests(self, seen: Observation) -> bool:
        """Whether it is still standing before the next move; the last rest ends the job."""
        if not math.isfinite(self._rested_since):
            return False
        if seen.stamp - self._rested_since < _REST:
            return True
        if self._done == len(self._moves):
            self._outcome = Outcome(None, "all moves made")
            return True
        self._rested_since, self._advanced_at = math.nan, seen.stamp
        self._gone = self._farthest = 0.0
        return False

    def _move(self, seen: Observation, move: Move) -> Decision:
        sign = math.copysign(1.0, move.amount)
        left = abs(move.amount) - sign * self._gone
        twist, near = self._twist(move.state, left)
        if left <= near:
            self._done += 1
            self._rested_since = seen.stamp
            return Decision(State.RESTING)
        if sign * self._gone > self._farthest + near:
            self._farthest, self._advanced_at = sign * self._gone, seen.stamp
        elif seen.stamp - self._advanced_at > _STUCK:
            self._outcome = Outcome(ErrorName.BLOCKED, f"the wheels got no further for {_STUCK:.0f} s: is it stuck?")
            return Decision(State.RESTING, STOP, self._outcome)
        return Decision(move.state, Twist2D(sign * twist.vx, sign * twist.wz))

    def _twist(self, state: State, left: float) -> tuple[Twist2D, float]:
        """Speeds with so much left to go, and how near counts as there."""
        limits = self._limits
        if state is State.TURNING:
            rate = _eased(left, min(TURN_RATE, limits.max_angular_velocity), limits.max_angular_acceleration)
            return Twist2D(0.0, rate), 0.02
        return Twist2D(
            _eased(left, min(DRIVE_SPEED, limits.max_linear_velocity), limits.max_linear_acceleration)
        ), 0.005


class SpinMotion(CalibrationMotion):
    """A bit more than one turn on the spot, to the left and back.

    One way would do, were it not for cameras that read the picture row by row: turning shears it, and a shear looks
    like tilt. The way back shears it the other way.
    """

    def __init__(self, limits: Limits) -> None:
        super().__init__(limits, (Move(State.TURNING, _SPIN), Move(State.TURNING, -_SPIN)))


class BaseMotion(CalibrationMotion):
    """Three turns each way, then LEG metres ahead and back five times, and ahead once more.

    Wheels slip by half a percent of a turn and a fifth of a drive: one of each would not do. It ends LEG ahead of where
    it began, for a person with a tape.
    """

    def __init__(self, limits: Limits) -> None:
        turn = _TURNS_EACH_WAY * 2.0 * math.pi
        turns = (Move(State.TURNING, turn), Move(State.TURNING, -turn))
        out, back = Move(State.DRIVING, LEG), Move(State.DRIVING, -LEG)
        super().__init__(limits, turns + (out, back) * _DRIVES + (out,))


def _in_the_way(seen: Observation) -> Outcome | None:
    if seen.bumper_left or seen.bumper_right:
        message = f"bumped into something: it needs {LEG + 0.3:.1f} m free ahead and room to turn"
        return Outcome(ErrorName.BLOCKED, message)
    if seen.cliff:
        return Outcome(ErrorName.BLOCKED, "the floor ends here: put the robot where it can turn and drive freely")
    return None


def _eased(left: float, fastest: float, acceleration: float) -> float:
    return min(fastest, max(_SLOWEST * fastest, stopping_speed(left, _BRAKING * acceleration)))


def _turned(before: Pose2D, seen: Observation) -> float:
    return wrap(seen.odom_from_base.yaw - before.yaw)


def _driven(before: Pose2D, seen: Observation) -> float:
    """Metres ahead since `before`, along the heading half-way."""
    now = seen.odom_from_base
    heading = before.yaw + wrap(now.yaw - before.yaw) / 2.0
    return (now.x - before.x) * math.cos(heading) + (now.y - before.y) * math.sin(heading)
