"""A made drive with simulated bearings (thesis, §5.3.1), and a filter that follows it."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.slam.bearing import wrapped
from omnibotd.core.slam.bearing_slam import BearingSlam
from omnibotd.core.slam.consistency import State, squared_error
from omnibotd.core.slam.motion import VelocityNoise, WheelNoise, WheelStep
from omnibotd.core.slam.sighting import Bearing, Initialiser

Floats = NDArray[np.float64]
RATE = 30.0
FRAMES = 2500
RANGE = 10.0  # of the sensor, m
NOISE_PER_FIELD = 0.0025  # standard deviation of a bearing, as a share of the field of view
# [assumed] Not in the thesis: where the four known landmarks stand, ahead of the start and in the narrowest view.
KNOWN = np.array([(1.0, 0.5), (1.0, -0.5), (1.6, 0.5), (1.6, -0.5)])
KNOWN_DEVIATION = 1e-4
# Landmarks all round, for tests of honesty.
RING = np.array([(4.0 * math.cos(a), 0.5 + 4.5 * math.sin(a)) for a in np.arange(12) * math.tau / 12 + 0.1])
VELOCITY_NOISE = VelocityNoise(0.05, 0.1)
_FASTEST, _SHARPEST = 0.8, 1.5
_DRIVE_SEED = 5


@dataclass(frozen=True, slots=True)
class Trial:
    """One drive: RMSE of position (m), NEES of the pose (mean, and at the end), what the filter said of itself."""

    error: float
    nees: float
    last_nees: float
    state: State


def drive(frames: int = FRAMES, seed: int = _DRIVE_SEED) -> Floats:
    """Poses (frames, 3) at 30 Hz from (0, 0, 0): from place to place in a room, speeding up and slowing down."""
    rng = np.random.default_rng(seed)
    x = y = heading = speed = turn = 0.0
    goal = (1.5, 1.0)
    poses = np.empty((frames, 3))
    for i in range(frames):
        poses[i] = x, y, heading
        if math.hypot(goal[0] - x, goal[1] - y) < 0.4:
            goal = (rng.uniform(-1.8, 1.8), rng.uniform(-1.8, 2.8))
        off = wrap(math.atan2(goal[1] - y, goal[0] - x) - heading)
        # Half a second of inertia each: no constant velocity, and no jumps either.
        turn += (np.clip(2.0 * off, -_SHARPEST, _SHARPEST) - turn) / RATE / 0.5
        speed += (_FASTEST * max(math.cos(off), 0.0) - speed) / RATE / 0.5
        middle = heading + turn / RATE / 2.0
        x, y = x + speed / RATE * math.cos(middle), y + speed / RATE * math.sin(middle)
        heading = wrap(heading + turn / RATE)
    return poses


def views(
    poses: Floats, landmarks: Floats, field: float, noise: float, rng: np.random.Generator
) -> list[list[Bearing]]:
    """Of landmarks (m, 2), named by their number, in range and in the `field` of view (rad) round the heading."""
    seen = []
    for x, y, heading in poses:
        dx, dy = landmarks[:, 0] - x, landmarks[:, 1] - y
        bearings = wrapped(np.arctan2(dy, dx) - heading)
        visible = np.flatnonzero((np.hypot(dx, dy) < RANGE) & (np.abs(bearings) <= field / 2.0))
        noisy = bearings[visible] + noise * rng.standard_normal(len(visible))
        seen.append([Bearing(int(i), float(z)) for i, z in zip(visible, noisy, strict=True)])
    return seen


def coasting(
    poses: Floats, landmarks: Floats, known: int, initialiser: Initialiser, field: float, noise: float, seed: int
) -> Trial:
    """The thesis' filter: constant velocity, no odometry, the first `known` landmarks given."""
    rng = np.random.default_rng(seed)
    slam = BearingSlam(initialiser, noise, Pose2D(*poses[0]), moving=True, plain=True)
    _give(slam, landmarks[:known], range(known))
    errors = []
    for i, view in enumerate(views(poses, landmarks, field, noise, rng)):
        if i:
            slam.coast(1.0 / RATE, VELOCITY_NOISE)
        slam.look(view, i / RATE)
        errors.append(_error(slam, poses[i]))
    return _trial(errors, slam)


def rolling(
    poses: Floats, landmarks: Floats, initialiser: Initialiser, noise: float, wheels: WheelNoise, seed: int
) -> Trial:
    """With wheels that err as `wheels` says, all landmarks unknown, a view all round at each of the `poses`."""
    rng = np.random.default_rng(seed)
    slam = BearingSlam(initialiser, noise, Pose2D(*poses[0]))
    errors = []
    for i, view in enumerate(views(poses, landmarks, math.tau, noise, rng)):
        if i:
            slam.roll(_slipped(Pose2D(*poses[i - 1]).inverse() @ Pose2D(*poses[i]), wheels, rng), wheels)
        slam.look(view, float(i))
        errors.append(_error(slam, poses[i]))
    return _trial(errors, slam)


def _slipped(true: Pose2D, noise: WheelNoise, rng: np.random.Generator) -> WheelStep:
    path = (math.hypot(true.x, true.y), abs(true.yaw))
    slip = rng.standard_normal(3) * np.sqrt(noise.variances(WheelStep(true, *path)))
    return WheelStep(Pose2D(true.x + slip[0], true.y + slip[1], true.yaw + slip[2]), *path)


def _give(slam: BearingSlam, points: Floats, names: Sequence[Hashable]) -> None:
    for name, point in zip(names, points, strict=True):
        slam.know(name, point, KNOWN_DEVIATION)


def _error(slam: BearingSlam, true: Floats) -> tuple[float, float]:
    """Square of the distance (m^2), and normalised of the whole pose."""
    error = slam.belief.pose - true
    error[2] = wrap(float(error[2]))
    return float(error[:2] @ error[:2]), squared_error(error, slam.belief.pose_covariance)


def _trial(errors: list[tuple[float, float]], slam: BearingSlam) -> Trial:
    squares, nees = np.array(errors).T
    return Trial(math.sqrt(squares.mean()), float(nees.mean()), float(nees[-1]), slam.health.state)
