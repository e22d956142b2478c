"""The image circle in synthetic frames of known circle."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.vision import image_circle
from omnibotd.core.vision.frame import Frame


def lens_picture(cx: float, cy: float, radius: float, seed: int = 0, noise: float = 6.0) -> Frame:
    """Blobs of light seen through a vignetting lens, dark round it, sensor noise on top."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:480, :640]
    distance = np.hypot(u - cx, v - cy) / radius
    scene = 110.0 + 40.0 * np.sin(u / 37.0 + seed) * np.cos(v / 23.0)
    light = scene * (1.0 - 0.4 * distance**2) * np.clip((1.0 - distance) * radius + 0.5, 0.0, 1.0)
    return Frame(0.0, np.clip(light + 8.0 + noise * rng.standard_normal(light.shape), 0, 255).astype(np.uint8))


@pytest.mark.parametrize(
    ("cx", "cy", "radius"),
    [(319.5, 239.5, 240.0), (330.0, 228.0, 200.0), (305.0, 250.0, 290.0)],
    ids=["fits", "small", "cut"],
)
def test_finds_centre_and_radius(cx: float, cy: float, radius: float) -> None:
    found = image_circle.find([lens_picture(cx, cy, radius, seed) for seed in range(3)])
    assert found is not None
    assert np.hypot(found[0] - cx, found[1] - cy) < 1.0
    assert found[2] == pytest.approx(radius, abs=1.5)


def test_many_frames_see_past_a_dark_side_of_the_room() -> None:
    frames = [lens_picture(319.5, 239.5, 235.0, seed) for seed in range(4)]
    for frame in frames[:3]:
        frame.data[:, 420:] //= 12  # type: ignore[index]
    found = image_circle.find(frames)
    assert found is not None
    assert np.hypot(found[0] - 319.5, found[1] - 239.5) < 1.5


def test_a_lens_that_fills_the_picture_has_no_circle() -> None:
    assert image_circle.find([lens_picture(319.5, 239.5, 700.0)]) is None


def test_darkness_and_bare_light_have_no_circle() -> None:
    assert image_circle.find([Frame(0.0, np.full((480, 640), value, np.uint8)) for value in (5, 5)]) is None
    assert image_circle.find([Frame(0.0, np.full((480, 640), 200, np.uint8))]) is None
    assert image_circle.find([]) is None


def test_a_bright_rectangle_is_no_circle() -> None:
    image = np.full((480, 640), 10, np.uint8)
    image[100:400, 120:520] = 150
    assert image_circle.find([Frame(0.0, image)]) is None
