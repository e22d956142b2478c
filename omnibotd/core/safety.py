"""The last word before the wheels: whatever was decided, only what is safe now goes out."""

from __future__ import annotations

import math
from dataclasses import dataclass

from omnibotd.core.decision import Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Twist2D

# Braking may be this much harder than speeding up: a late stop is worse than a jerk.
BRAKING = 2.5
# Kept free of whatever the range sensor sees (m), and what passes between a look and the wheels' answer to it (s): a
# tick, two telemetry periods and the motors' lag.
RANGE_MARGIN, REACTION = 0.05, 0.25


@dataclass(frozen=True, slots=True)
class Limits:
    """What the base can and may do; m/s, rad/s, m/s^2, rad/s^2."""

    max_linear_velocity: float
    max_angular_velocity: float
    max_linear_acceleration: float
    max_angular_acceleration: float


def hazard(seen: Observation) -> str | None:
    """Why the robot must not move at all, or None."""
    if seen.emergency_stop:
        return "emergency stop"
    if not seen.base_ok:
        return "base link down"
    if seen.wheel_drop:
        return "a wheel has dropped"
    return None


def danger(seen: Observation) -> Outcome | None:
    """What ends every job that drives by the camera, in any of its states; worst first."""
    if seen.emergency_stop:
        return Outcome(ErrorName.EMERGENCY_STOP, "the emergency stop is pressed; release it and start again")
    if not seen.base_ok:
        return Outcome(ErrorName.BASE_LINK_DOWN, "the base stopped answering; check its cable and power")
    if not seen.camera_ok:
        return Outcome(ErrorName.CAMERA_DOWN, "no picture from the camera for a second; check its cable")
    if seen.wheel_drop:
        return Outcome(ErrorName.BLOCKED, "a wheel hangs in the air; put the robot on the floor and start again")
    return None


def stopping_speed(way: float, deceleration: float) -> float:
    """The speed (m/s) from which a base that brakes REACTION seconds from now stands still within `way` metres."""
    late = deceleration * REACTION
    return math.sqrt(late * late + 2.0 * deceleration * max(way, 0.0)) - late


class SafetyGate:
    """Clamps speeds and accelerations, and vetoes motion into what bumpers, cliff and range sensors report."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._last = STOP

    def limit(self, wanted: Twist2D, seen: Observation, dt: float) -> Twist2D:
        """The twist that may go to the wheels now; `dt` (s) since the last call. Not a number means stop."""
        if hazard(seen) is not None or not (math.isfinite(wanted.vx) and math.isfinite(wanted.wz)):
            return self.stop()
        vx = self._clamp(wanted.vx, self._limits.max_linear_velocity)
        wz = self._clamp(wanted.wz, self._limits.max_angular_velocity)
        vx = self._ramp(self._last.vx, vx, self._limits.max_linear_acceleration * dt)
        wz = self._ramp(self._last.wz, wz, self._limits.max_angular_acceleration * dt)
        if seen.bumper_left or seen.bumper_right or seen.cliff:
            vx = min(vx, 0.0)
        if seen.range_ahead is not None:
            # No ramp here: this bound falls no faster than the base can brake, unless somebody steps in the way.
            vx = min(vx, stopping_speed(seen.range_ahead - RANGE_MARGIN, self._limits.max_linear_acceleration))
        self._last = Twist2D(vx, wz)
        return self._last

    def stop(self) -> Twist2D:
        """Stand at once, without a ramp, and start the next motion from standing."""
        self._last = STOP
        return STOP

    @staticmethod
    def _clamp(value: float, bound: float) -> float:
        return max(-bound, min(bound, value))

    @staticmethod
    def _ramp(last: float, wanted: float, step: float) -> float:
        slower = abs(wanted) < abs(last) or wanted * last < 0.0
        allowed = step * BRAKING if slower else step
        return max(last - allowed, min(last + allowed, wanted))
