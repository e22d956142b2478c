"""Dynamic window control (Fox, Burgard, Thrun 1997; thesis §6.5.5).

Of the velocities reachable within one cycle, the one nearest to what is wanted whose arc stays on free floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.navigation.floor import DrivenFloor
from omnibotd.core.safety import Limits

# rad; facing away by more, the robot turns on the spot first and then goes the direct way (no loops, unlike §6.5.6).
TURN_IN_PLACE = 0.5
SLOWING = 0.9  # 1/s: forward speed is at most this much a metre left
TURNING = 2.0  # 1/s: turn rate a radian of bearing
# Below this a real base stalls in its own friction.
MIN_TURN = 0.08  # rad/s
HORIZON = 0.8  # s; at 0.3 m/s an arc of 24 cm, longer than it takes to brake
LINEAR_SAMPLES, TURN_SAMPLES, ARC_POINTS = 7, 11, 6


def pursuit(bearing: float, distance: float, limits: Limits) -> Twist2D:
    """The velocity one would like: turn towards the target, drive when it is ahead, slow into it."""
    wz = _saturate(TURNING * bearing, limits.max_angular_velocity)
    if abs(bearing) > TURN_IN_PLACE:
        return Twist2D(0.0, wz)
    return Twist2D(min(limits.max_linear_velocity, SLOWING * distance) * math.cos(bearing), wz)


def turn(error: float, limits: Limits) -> Twist2D:
    """Turn on the spot by `error` rad, slowing into it but not below what moves the base."""
    wz = _saturate(TURNING * error, limits.max_angular_velocity)
    return Twist2D(0.0, wz if abs(wz) > MIN_TURN else math.copysign(MIN_TURN, error))


@dataclass(frozen=True, slots=True)
class DynamicWindow:
    """Chooses among (v, w) samples reachable in `period` seconds from the current velocity."""

    limits: Limits
    period: float

    def choose(self, wanted: Twist2D, current: Twist2D, here: Pose2D, floor: DrivenFloor) -> Twist2D:
        """The admissible sample nearest to `wanted`; STOP where every arc leaves the floor."""
        v, w = self._window(wanted, current)
        admissible = floor.contains(_arcs(v, w, here)).all(axis=-1)
        if not admissible.any():
            return STOP
        miss = np.abs(v - wanted.vx) / self.limits.max_linear_velocity
        miss += np.abs(w - wanted.wz) / self.limits.max_angular_velocity
        best = int(np.argmin(np.where(admissible, miss, np.inf)))
        return Twist2D(float(v[best]), float(w[best]))

    def _window(self, wanted: Twist2D, current: Twist2D) -> tuple[np.ndarray, np.ndarray]:
        """Samples (K,) of v and w, among them the reachable velocity closest to the one wanted."""
        dv = self.limits.max_linear_acceleration * self.period
        dw = self.limits.max_angular_acceleration * self.period
        v = np.linspace(max(0.0, current.vx - 2 * dv), max(0.0, current.vx + dv), LINEAR_SAMPLES)
        w = np.linspace(current.wz - 2 * dw, current.wz + 2 * dw, TURN_SAMPLES)
        v = np.r_[0.0, v, np.clip(wanted.vx, v[0], v[-1])]
        w = np.r_[w, np.clip(wanted.wz, w[0], w[-1])]
        v = np.minimum(v, self.limits.max_linear_velocity)
        w = np.clip(w, -self.limits.max_angular_velocity, self.limits.max_angular_velocity)
        grid_v, grid_w = np.meshgrid(v, w)
        return grid_v.ravel(), grid_w.ravel()


def _arcs(v: np.ndarray, w: np.ndarray, here: Pose2D) -> np.ndarray:
    """Points (K, ARC_POINTS, 2) in the map along each arc, over the horizon."""
    t = np.linspace(HORIZON / ARC_POINTS, HORIZON, ARC_POINTS)
    heading = here.yaw + w[:, None] * t / 2.0
    chord = v[:, None] * t * np.sinc(w[:, None] * t / 2.0 / np.pi)
    return np.stack([here.x + chord * np.cos(heading), here.y + chord * np.sin(heading)], axis=-1)


def _saturate(value: float, bound: float) -> float:
    return max(-bound, min(bound, value))
