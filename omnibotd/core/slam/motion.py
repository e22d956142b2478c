"""How the vehicle moves between two looks: at constant velocity (thesis, §5.2.1), or as its wheels say."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D

Floats = NDArray[np.float64]
# Below this half angle (rad) the series of the chord and of its slope are exact to the last digit or nearly so.
_SMALL = 1e-3


@dataclass(frozen=True, slots=True)
class Motion:
    """Of a vehicle with k numbers: its new `mean` (k,), the `jacobian` by the old (k, k), the `noise` added (k, k)."""

    mean: Floats
    jacobian: Floats
    noise: Floats


@dataclass(frozen=True, slots=True)
class VelocityNoise:
    """Standard deviations of the change of speed (m/s) and of turn rate (rad/s) from one step to the next."""

    speed: float = 0.05
    turn: float = 0.1


@dataclass(frozen=True, slots=True)
class WheelStep:
    """What wheels say of one step: the move in the old base frame, and the path behind it.

    `rolled` (m) and `turned` (rad) are absolute sums over the step; `silent` (s) is time without odometry in it.
    """

    move: Pose2D
    rolled: float
    turned: float
    silent: float = 0.0


@dataclass(frozen=True, slots=True)
class WheelNoise:
    """Errors that grow with the root of the path: m per sqrt(m) along and across, rad per sqrt(rad) and sqrt(m).

    Silence of the odometry adds a speed (m/s) and a turn rate (rad/s) that nobody knows.
    """

    along: float = 0.02
    across: float = 0.005
    turn_by_turn: float = 0.03
    turn_by_path: float = 0.03
    silent_speed: float = 0.03
    silent_turn: float = 0.10

    def variances(self, step: WheelStep) -> Floats:
        """Of the step along x, y and yaw of the old base frame, (3,)."""
        rolled, turned, silent = step.rolled, step.turned, step.silent
        along = self.along**2 * rolled + (self.silent_speed * silent) ** 2
        yaw = self.turn_by_turn**2 * turned + self.turn_by_path**2 * rolled + (self.silent_turn * silent) ** 2
        # A robot at rest creeps a little: covariances of exactly nothing would let rounding decide.
        return np.array([along, self.across**2 * rolled, yaw]) + 1e-10


def constant_velocity(vehicle: Floats, dt: float, noise: VelocityNoise) -> Motion:
    """(x, y, heading, speed, turn rate) after `dt` seconds (Eq 5.3), in the form that knows no 0/0 at turn rate 0."""
    x, y, heading, speed, turn = vehicle
    half = turn * dt / 2.0
    chord, slope = _chord(half)
    c, s = math.cos(heading + half), math.sin(heading + half)
    path = speed * dt * chord
    jacobian = np.eye(5)
    jacobian[0, 2:] = -path * s, dt * chord * c, speed * dt**2 / 2.0 * (slope * c - chord * s)
    jacobian[1, 2:] = path * c, dt * chord * s, speed * dt**2 / 2.0 * (slope * s + chord * c)
    jacobian[2, 4] = dt
    by_noise = jacobian[:, 3:]
    spread = by_noise * np.array([noise.speed, noise.turn]) ** 2 @ by_noise.T
    return Motion(np.array([x + path * c, y + path * s, heading + turn * dt, speed, turn]), jacobian, spread)


def wheel_motion(vehicle: Floats, step: WheelStep, noise: WheelNoise) -> Motion:
    """(x, y, heading) after a step of the wheels."""
    x, y, heading = vehicle
    c, s = math.cos(heading), math.sin(heading)
    dx, dy = c * step.move.x - s * step.move.y, s * step.move.x + c * step.move.y
    jacobian = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    spread = turned * noise.variances(step) @ turned.T
    return Motion(np.array([x + dx, y + dy, heading + step.move.yaw]), jacobian, spread)


def _chord(half: float) -> tuple[float, float]:
    """sin(h)/h, chord over arc, and its derivative by h."""
    if abs(half) < _SMALL:
        return 1.0 - half * half / 6.0, -half / 3.0
    return math.sin(half) / half, (half * math.cos(half) - math.sin(half)) / half**2
