"""A crooked pair found from landmarks: it comes out right, and knows how right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.optics.calibration import PARAMETERS, OpticsError, calibrate, calibrate_pair, displaced
from omnibotd.core.optics.camera import Pinhole
from omnibotd.core.optics.cone import Cone
from omnibotd.core.optics.rigid import Rigid
from omnibotd.core.optics.sensor import ConeSensor
from omnibotd.core.optics.stereo import StereoPair

LOWER = ConeSensor.aligned(Cone(0.05), Pinhole(600.0, 320.0, 240.0), 0.10)
UPPER = replace(LOWER, frame_from_cone=Rigid.of(shift=(0.0, 0.0, 0.25)))
DRAWING = StereoPair(UPPER, LOWER)
SPREAD = np.array([np.radians(6.0)] * 3 + [0.006] * 3 + [np.radians(6.0)] * 2 + [0.006] * 3)


def landmarks(rng: np.random.Generator, count: int = 60) -> np.ndarray:
    bearing, away = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.6, 3.0, count)
    below = -rng.uniform(-0.1, 0.2, count) * away
    return np.stack([away * np.cos(bearing), away * np.sin(bearing), below], axis=1)


def noisy(rng: np.random.Generator, sensor: ConeSensor, points: np.ndarray, sigma: float) -> np.ndarray:
    return sensor.pixels(points) + rng.normal(scale=sigma, size=(len(points), 2))


def test_without_noise_the_sensor_is_found() -> None:
    rng = np.random.default_rng(1)
    true = displaced(LOWER, rng.normal(size=PARAMETERS) * SPREAD)
    points = landmarks(rng)
    found = calibrate(LOWER, points, true.pixels(points), sigma=1e-3).sensor
    other = landmarks(rng)
    seen = np.isfinite(true.pixels(other)).all(axis=1)
    assert seen.sum() > 15
    assert np.abs(found.pixels(other) - true.pixels(other))[seen].max() < 0.02


def test_covariance_is_that_of_the_errors() -> None:
    """Over sensors put together as badly as is assumed, 5 x 11 squared normalised errors."""
    squares = []
    for seed in range(5):
        rng = np.random.default_rng((2, seed))
        numbers, points = rng.normal(size=PARAMETERS) * SPREAD, landmarks(rng)
        found = calibrate(LOWER, points, noisy(rng, displaced(LOWER, numbers), points, 0.1), sigma=0.1)
        assert 0.5 < found.misfit < 1.3
        errors = _numbers(found.sensor) - numbers
        squares.append(errors @ np.linalg.solve(found.covariance, errors))
    assert 36.0 < sum(squares) < 78.0  # chi^2 of 55: 95 % within


def _numbers(sensor: ConeSensor) -> np.ndarray:
    """What `displaced` would make this sensor of LOWER."""
    turn, tilt = sensor.cone_from_camera.rotation, sensor.frame_from_cone.rotation
    shift = sensor.cone_from_camera.translation - LOWER.cone_from_camera.translation
    return np.concatenate([_vector(turn), shift, _vector(tilt)[:2], sensor.frame_from_cone.translation])


def _vector(rotation: np.ndarray) -> np.ndarray:
    angle = np.arccos((np.trace(rotation) - 1.0) / 2.0)
    skew = rotation - rotation.T
    return angle / (2.0 * np.sin(angle)) * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def test_a_calibrated_pair_measures_and_says_how_well() -> None:
    rng = np.random.default_rng(3)
    true = [displaced(s, 0.5 * rng.normal(size=PARAMETERS) * SPREAD) for s in (UPPER, LOWER)]
    points, sigma = landmarks(rng), 0.1
    found = calibrate_pair(DRAWING, points, *(noisy(rng, s, points, sigma) for s in true), sigma)
    bearing = np.linspace(-3.0, 3.0, 80)
    goals = np.stack([2.0 * np.cos(bearing), 2.0 * np.sin(bearing), np.full(80, -0.25)], axis=1)
    fixes, covariance = found.locate(*(noisy(rng, s, goals, sigma) for s in true), sigma)
    errors = fixes.points - goals
    ok = np.isfinite(errors).all(axis=1)
    squares = np.einsum("ni,ni->n", errors[ok], np.linalg.solve(covariance[ok], errors[ok][..., None])[..., 0])
    assert ok.sum() > 30
    assert np.median(np.linalg.norm(errors[ok], axis=1)) < 0.02
    assert 1.0 < np.median(squares) < 5.0  # chi^2 of 3 has its median at 2.4; the calibration's part is common to all


def test_the_drawing_is_not_good_enough() -> None:
    """What the calibration is for: the same pixels read by the drawing are decimetres off."""
    rng = np.random.default_rng(4)
    true = [displaced(s, 0.5 * rng.normal(size=PARAMETERS) * SPREAD) for s in (UPPER, LOWER)]
    goals = landmarks(rng)
    errors = DRAWING.locate(*(s.pixels(goals) for s in true)).points - goals
    assert np.nanmedian(np.linalg.norm(errors, axis=1)) > 0.1


def test_too_few_landmarks() -> None:
    points = landmarks(np.random.default_rng(5))[:5]
    with pytest.raises(OpticsError, match="six or more"):
        calibrate(LOWER, points, np.zeros((5, 2)), 0.1)


def test_mismatched_shapes() -> None:
    with pytest.raises(OpticsError, match="are needed"):
        calibrate(LOWER, np.zeros((7, 3)), np.zeros((8, 2)), 0.1)
