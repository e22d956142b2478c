"""The last word before the wheels: whatever was decided, only what is safe now goes out."""

from __future__ import annotations

import math
from dataclasses import dataclass

from omnibotd.core.decision import Observation
from omnibotd.core.geometry import STOP, Twist2D

# Braking may be this much harder than speeding up: a late stop is worse than a jerk.
BRAKING = 2.5


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


class SafetyGate:
    """Clamps speeds and accelerations, and vetoes motion into what bumpers and cliff sensors report."""

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
