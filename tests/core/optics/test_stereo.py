"""Range by two mirrors, and motion from a landmark: exact where the inputs are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.optics.aligned import depth_below_tip, focal_length, stereo_range
from omnibotd.core.optics.camera import Pinhole
from omnibotd.core.optics.cone import Cone
from omnibotd.core.optics.rigid import Rigid
from omnibotd.core.optics.sensor import ConeSensor, Sights
from omnibotd.core.optics.stereo import StereoPair, translation, triangulate

D, S, V = 0.10, 0.25, 600.0
LOWER = ConeSensor.aligned(Cone(0.05), Pinhole(V, 320.0, 240.0), D)
UPPER = replace(LOWER, frame_from_cone=Rigid.of(shift=(0.0, 0.0, S)))


def landmarks(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(points seen by both, their ranges from the axis)."""
    away, bearing = rng.uniform(0.8, 6.0, count), rng.uniform(-np.pi, np.pi, count)
    below = -rng.uniform(0.002, 0.02, count) * away
    return np.stack([away * np.cos(bearing), away * np.sin(bearing), below], axis=1), away


def test_aligned_stereo_is_the_closed_form() -> None:
    points, away = landmarks(np.random.default_rng(1), 200)
    distances = [np.linalg.norm(s.pixels(points) - s.tip(), axis=1) for s in (UPPER, LOWER)]
    by_formula = stereo_range(*distances, V, D, S)
    assert np.abs(by_formula / away - 1.0).max() < 1e-9  # projection rounds to 1e-10 px
    assert np.abs(depth_below_tip(distances[1], away, V, D) + points[:, 2]).max() < 1e-9


def test_the_closed_form_inverts_its_own_projection() -> None:
    away, depth = np.linspace(0.5, 6.0, 50), 0.05
    shown = [V * (depth + height) / (away + D) for height in (S, 0.0)]
    assert np.abs(stereo_range(*shown, V, D, S) - away).max() < 1e-12
    assert np.isnan(stereo_range(3.0, 3.0, V, D, S))


def test_focal_length_from_the_mirrors_size() -> None:
    rim = np.array([[0.05, 0.0, -0.05 - D]])  # in the camera's axes
    radius = Pinhole(V, 0.0, 0.0).pixels(rim)[0, 0]
    assert focal_length(D, 0.05, radius) == pytest.approx(V, abs=1e-9)


def test_crooked_stereo_is_exact() -> None:
    rng = np.random.default_rng(2)
    points, _ = landmarks(rng, 100)
    points[:, 2] -= 0.15
    sensors = []
    for sensor in (UPPER, LOWER):
        off = Rigid.of(np.radians(rng.uniform(-4, 4, 3)), rng.uniform(-0.004, 0.004, 3))
        pose = sensor.cone_from_camera
        moved = Rigid(off.rotation @ pose.rotation, pose.translation + off.translation)
        sensors.append(replace(sensor, cone_from_camera=moved))
    pair = StereoPair(*sensors)
    seen = [s.pixels(points) for s in sensors]
    both = np.isfinite(seen[0]).all(axis=1) & np.isfinite(seen[1]).all(axis=1)
    assert both.sum() > 50
    fixes = pair.locate(seen[0][both], seen[1][both])
    assert np.abs(fixes.points - points[both]).max() < 1e-6
    assert fixes.gap.max() < 1e-8


def test_lines_that_do_not_meet_are_no_fix() -> None:
    first = Sights(np.zeros((3, 3)), np.array([[1.0, 0.0, 0.0]] * 3))
    second = Sights(
        np.array([[0.0, 1.0, 0.0], [2.0, 1.0, 0.3], [2.0, 1.0, 0.3]]),
        np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]),
    )
    fixes = triangulate(first, second)
    assert np.isnan(fixes.points[:2]).all()  # parallel; behind
    assert np.allclose(fixes.points[2], [2.0, 0.0, 0.15])
    assert fixes.gap[2] == pytest.approx(0.3)


@pytest.mark.parametrize("count", [1, 5])
def test_translation_is_exact(count: int) -> None:
    rng = np.random.default_rng(3)
    first_from_second = Pose2D(0.4, -0.15, 0.7)
    marks = rng.uniform(-3.0, 3.0, (count, 2))
    inside = np.array([first_from_second.inverse().transform(x, y) for x, y in marks])
    before, after = (np.stack([np.hypot(*p.T), np.arctan2(p[:, 1], p[:, 0])], axis=1) for p in (marks, inside))
    assert np.abs(translation(before, after, 0.7) - [0.4, -0.15]).max() < 1e-12


def test_translation_needs_the_same_landmarks() -> None:
    with pytest.raises(ValueError, match="at least one"):
        translation(np.zeros((0, 2)), np.zeros((0, 2)), 0.0)
