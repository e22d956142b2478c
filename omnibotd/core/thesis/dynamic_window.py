"""The thesis' dynamic window controller: never slower than 0.2 m/s (§6.5.5, Fox et al. 1997; weights unpublished)."""

from __future__ import annotations

import math

import numpy as np

from omnibotd.core.geometry import Twist2D
from omnibotd.core.safety import Limits

MIN_SPEED, MAX_SPEED = 0.2, 0.3  # m/s while navigating; this makes the wide loops that the thesis reports
MAX_TURN = 1.0  # rad/s
HORIZON = 1.5  # s, [assumed]
# Weights of heading (a half turn), distance left (m) and speed (m/s), [assumed]. The experiments had no obstacles and
# nothing measures clearance, so Fox's third term has nothing to weigh.
HEADING, DISTANCE, SPEED = 1.0, 0.3, 0.1
SPEEDS, TURNS = 3, 9  # samples of the window


def choose(current: Twist2D, goal: tuple[float, float], limits: Limits, period: float) -> Twist2D:
    """The best of the velocities reachable in `period` seconds, for a goal (x, y) in the robot's frame, m."""
    v, w = _window(current, limits, period)
    turned = w * HORIZON
    chord = v * HORIZON * np.sinc(turned / (2.0 * math.pi))
    left_x, left_y = goal[0] - chord * np.cos(turned / 2.0), goal[1] - chord * np.sin(turned / 2.0)
    off = np.arctan2(left_y, left_x) - turned
    off = np.abs(np.arctan2(np.sin(off), np.cos(off)))
    cost = HEADING * off / math.pi + DISTANCE * np.hypot(left_x, left_y) - SPEED * v
    best = int(np.argmin(cost))
    return Twist2D(float(v[best]), float(w[best]))


def _window(current: Twist2D, limits: Limits, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples (K,) of v and w. From below the least speed the least speed counts as reachable; the ramp is others'."""
    top, turn = min(MAX_SPEED, limits.max_linear_velocity), min(MAX_TURN, limits.max_angular_velocity)
    low = min(MIN_SPEED, top)
    dv, dw = limits.max_linear_acceleration * period, limits.max_angular_acceleration * period
    v = np.linspace(np.clip(current.vx - dv, low, top), np.clip(current.vx + dv, low, top), SPEEDS)
    w = np.linspace(max(-turn, current.wz - dw), min(turn, current.wz + dw), TURNS)
    grid_v, grid_w = np.meshgrid(v, w)
    return grid_v.ravel(), grid_w.ravel()
