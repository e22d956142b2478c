"""The growing batch: exact on exact data, better than dead reckoning on noisy, and honest about misfits."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.slam.motion import WheelNoise, WheelStep
from omnibotd.core.slam.sighting import Bearing
from omnibotd.core.slam.smoother import Smoothed, smoothed
from tools.reproduction.mrclam import aligned_error
from tools.reproduction.slam_simulation import RING, drive, views

WHEELS = WheelNoise(0.05, 0.02, 0.1, 0.1)
POSES = drive(2400)[::15]
STAMPS = np.arange(len(POSES)) / 2.0


def steps(slip: float, seed: int = 0) -> list[WheelStep]:
    """True steps, each erring by `slip` times what `WHEELS` says."""
    rng, found = np.random.default_rng(seed), []
    for a, b in pairwise(POSES):
        move = Pose2D(*a).inverse() @ Pose2D(*b)
        path = (math.hypot(move.x, move.y), abs(move.yaw))
        off = slip * rng.standard_normal(3) * np.sqrt(WHEELS.variances(WheelStep(move, *path)))
        found.append(WheelStep(Pose2D(move.x + off[0], move.y + off[1], move.yaw + off[2]), *path))
    return found


def solved(noise: float, slip: float, misread: float = 0.0) -> Smoothed:
    rng = np.random.default_rng(1)
    seen = views(POSES, RING, math.radians(120), noise, rng)
    wrong = [[Bearing(b.name, b.angle + rng.uniform(-3, 3) * (rng.random() < misread)) for b in view] for view in seen]
    return smoothed(STAMPS, steps(slip), wrong, WHEELS, math.radians(1.0))


def test_exact_measurements_give_the_exact_trajectory() -> None:
    found = solved(0.0, 0.0)
    assert found.poses == pytest.approx(POSES, abs=1e-3)
    assert len(found.landmarks) == len(RING)
    for name, point in found.landmarks.items():
        # A loose prior draws landmarks by a ten thousandth of their distance.
        assert point == pytest.approx(RING[int(str(name))], abs=0.02)


@pytest.mark.parametrize("misread", [0.0, 0.05])
def test_bearings_take_the_drift_out(misread: float) -> None:
    pose, path = Pose2D(), [(0.0, 0.0)]
    for step in steps(1.0):
        pose = pose @ step.move
        path.append((pose.x, pose.y))
    drift = aligned_error(np.array(path), POSES[:, :2])
    found = solved(math.radians(1.0), 1.0, misread)
    assert aligned_error(found.poses[:, :2], POSES[:, :2]) < drift / 5
    assert not found.doubtful


def test_bearings_of_nothing_are_doubtful() -> None:
    assert solved(math.radians(40.0), 0.0).doubtful
