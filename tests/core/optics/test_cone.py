"""Reflection in a cone: against the laws of optics, not against the other half of the code."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.optics.camera import Pinhole
from omnibotd.core.optics.cone import Cone
from omnibotd.core.optics.rigid import Rigid, rotation_matrix
from omnibotd.core.optics.sensor import ConeSensor

CAMERA = Pinhole(800.0, 320.0, 240.0)
LENS = 0.10


def crooked(rng: np.random.Generator, ratio: float, tilt_deg: float, offset_mm: float) -> ConeSensor:
    """A sensor off its axis by so much, in random directions; a mirror 5 cm high or wide."""
    turn, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    pose = Rigid.of(np.radians(tilt_deg) * turn, np.array([0.0, 0.0, LENS]) + 1e-3 * offset_mm * shift)
    return ConeSensor(Cone(0.05 / max(ratio, 1.0), ratio), CAMERA, pose)


def shown_pixels(rng: np.random.Generator, sensor: ConeSensor, count: int) -> np.ndarray:
    radius, angle = rng.uniform(20.0, 230.0, count), rng.uniform(-np.pi, np.pi, count)
    return sensor.tip() + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("ratio", [0.7, 1.0, 1.4])
def test_a_sight_obeys_the_mirror(ratio: float) -> None:
    sensor = crooked(np.random.default_rng(1), ratio, 10.0, 10.0)
    pixels = shown_pixels(np.random.default_rng(2), sensor, 500)
    sights = sensor.sights(pixels)
    ok = np.isfinite(sights.origin[:, 0])
    x, y, z = sights.origin[ok].T
    assert ok.sum() > 300
    assert np.abs(z + ratio * np.hypot(x, y)).max() < 1e-12
    outwards = np.stack([ratio * x / np.hypot(x, y), ratio * y / np.hypot(x, y), np.ones_like(x)], axis=1)
    incoming = sights.origin[ok] - sensor.cone_from_camera.translation
    incoming /= np.linalg.norm(incoming, axis=1, keepdims=True)
    leaving = sights.direction[ok]
    assert np.abs(np.linalg.norm(leaving, axis=1) - 1.0).max() < 1e-12
    assert np.abs(np.sum((incoming + leaving) * outwards, axis=1)).max() < 1e-12  # angle in = angle out
    assert np.abs(np.sum(np.cross(incoming, leaving) * outwards, axis=1)).max() < 1e-12  # in one plane


@pytest.mark.parametrize("ratio", [0.7, 1.0, 1.4])
def test_aligned_sights_come_from_the_circle_of_viewpoints(ratio: float) -> None:
    sensor = ConeSensor.aligned(Cone(0.05 / max(ratio, 1.0), ratio), CAMERA, LENS)
    sights = sensor.sights(shown_pixels(np.random.default_rng(3), sensor, 200))
    ok = np.isfinite(sights.origin[:, 0])
    origin, direction = sights.origin[ok], sights.direction[ok]
    outwards = origin[:, :2] / np.linalg.norm(origin[:, :2], axis=1, keepdims=True)
    radial = np.stack([np.sum(origin[:, :2] * outwards, axis=1), np.sum(direction[:, :2] * outwards, axis=1)])
    at = np.array([-2.0 * ratio, ratio**2 - 1.0]) * LENS / (1.0 + ratio**2)
    passing = (at[0] - radial[0]) * direction[:, 2] - (at[1] - origin[:, 2]) * radial[1]
    assert np.abs(passing).max() < 1e-12


@pytest.mark.parametrize(("tilt", "offset"), [(0.0, 0.0), (10.0, 10.0), (25.0, 30.0)])
def test_rays_back_up_to_their_camera_miss(tilt: float, offset: float) -> None:
    sensor = crooked(np.random.default_rng(4), 1.0, tilt, offset)
    eye = sensor.cone_from_camera.translation
    assert np.isnan(sensor.cone.struck(eye, np.array([[0.1, 0.2, 0.97]]))).all()


def test_the_rim_ends_the_mirror() -> None:
    sensor = ConeSensor.aligned(Cone(0.05), CAMERA, LENS)
    rim = 800.0 * 0.05 / (LENS + 0.05)
    ends = np.array([[320.0 + rim - 1e-6, 240.0], [320.0 + rim + 1e-6, 240.0]])
    assert np.isfinite(sensor.sights(ends).origin[0]).all()
    assert np.isnan(sensor.sights(ends).origin[1]).all()


@pytest.mark.parametrize("ratio", [0.7, 1.0, 1.4])
@pytest.mark.parametrize(("tilt", "offset"), [(0.0, 0.0), (1.0, 1.0), (10.0, 10.0), (20.0, 30.0)])
def test_round_trip(ratio: float, tilt: float, offset: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(4):
        sensor = crooked(rng, ratio, tilt, offset)
        pixels = shown_pixels(rng, sensor, 100)
        sights = sensor.sights(pixels)
        ok = np.isfinite(sights.origin[:, 0])
        points = (sights.origin + rng.uniform(0.3, 8.0, (100, 1)) * sights.direction)[ok]
        assert np.abs(sensor.pixels(points) - pixels[ok]).max() < 1e-6


def test_ten_thousand_random_cases_converge() -> None:
    """Each with its own camera, up to 10 degrees and 10 mm off."""
    rng = np.random.default_rng(6)
    cases = 0
    for _ in range(100):
        sensor = crooked(rng, 1.0, rng.uniform(0.0, 10.0), rng.uniform(0.0, 10.0))
        pixels = shown_pixels(rng, sensor, 130)
        sights = sensor.sights(pixels)
        ok = np.flatnonzero(np.isfinite(sights.origin[:, 0]))[:100]
        points = sights.origin[ok] + rng.uniform(0.3, 8.0, (len(ok), 1)) * sights.direction[ok]
        assert np.abs(sensor.pixels(points) - pixels[ok]).max() < 1e-6
        cases += len(ok)
    assert cases == 10_000


def test_what_is_shown_is_shown_by_the_shortest_way() -> None:
    """Points anywhere: where one is shown, no way over the mirror is shorter; where not, none obeys the mirror."""
    rng = np.random.default_rng(7)
    sensor = crooked(rng, 1.0, 8.0, 8.0)
    eye, points = sensor.cone_from_camera.translation, rng.uniform(-1.0, 1.0, (100, 3))
    mirrored = Cone(10.0).mirrored(eye, points)
    azimuth, rho = np.meshgrid(np.linspace(-np.pi, np.pi, 121), np.geomspace(1e-4, 5.0, 150))
    grid = np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), -rho], axis=-1).reshape(-1, 3)
    outwards = np.stack([np.cos(azimuth), np.sin(azimuth), np.ones_like(rho)], axis=-1).reshape(-1, 3)
    for point, at in zip(points, mirrored, strict=True):
        ways = np.linalg.norm(grid - eye, axis=1) + np.linalg.norm(grid - point, axis=1)
        best = int(np.argmin(ways))
        open_to_both = (outwards[best] @ (point - grid[best]) > 1e-2) and 2e-4 < rho.flat[best] < 4.0
        if np.isfinite(at[0]):
            assert np.linalg.norm(at - eye) + np.linalg.norm(at - point) <= ways[best] + 1e-9
        else:
            assert not open_to_both
    assert 15 < np.isfinite(mirrored[:, 0]).sum() < 85


def test_a_bad_cone_is_refused() -> None:
    with pytest.raises(ValueError, match="positive"):
        Cone(0.0)


def test_rotation_vector() -> None:
    assert np.allclose(rotation_matrix(np.array([0.0, 0.0, np.pi / 2])), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    turn = Rigid.of((0.3, -0.2, 2.0), (1.0, 2.0, 3.0))
    there_and_back = turn @ turn.inverse()
    assert np.allclose(there_and_back.rotation, np.eye(3), atol=1e-14)
    assert np.allclose(there_and_back.translation, 0.0, atol=1e-14)


class FisheyeLens:
    """Another camera than a pinhole: r = f theta."""

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        theta, turn = np.hypot(*pixels.T) / 300.0, np.arctan2(-pixels[:, 1], pixels[:, 0])
        return np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), -np.cos(theta)], axis=1)

    def pixels(self, rays: np.ndarray) -> np.ndarray:
        theta, turn = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), -rays[:, 2]), np.arctan2(rays[:, 1], rays[:, 0])
        return 300.0 * np.stack([theta * np.cos(turn), -theta * np.sin(turn)], axis=1)


def test_any_camera_will_do() -> None:
    sensor = ConeSensor(Cone(0.05), FisheyeLens(), Rigid.of((0.1, 0.05, 0.3), (0.004, -0.006, 0.05)))
    angle = np.linspace(-3.0, 3.0, 40)
    pixels = sensor.tip() + 60.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sights = sensor.sights(pixels)
    assert np.abs(sensor.pixels(sights.origin + 2.0 * sights.direction) - pixels).max() < 1e-6
