"""The 7986 samples: how many, where, and what turning does to them."""

import math

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.thesis.vector import LENGTH, Perceiver, gradient_magnitude, sample_circles
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tests.core.thesis.rooms import room_with_tiles


def field(function: str) -> np.ndarray:
    """(120, 160) of a coordinate about the image's centre."""
    v, u = np.mgrid[0:120, 0:160].astype(np.float32)
    u, v = u - 79.5, v - 59.5
    return {"u": u, "v": v, "r": np.hypot(u, v)}[function].astype(np.float32)


def test_there_are_7986_samples() -> None:
    """The count is printed in the thesis; a disc of pixels of that radius would hold 7845."""
    assert LENGTH == 7986
    assert sample_circles(field("u"), 0.0).shape == (7986,)


def test_samples_lie_on_circles_of_1_to_50_pixels() -> None:
    radii = sample_circles(field("r"), 0.3)
    first, last = math.floor(2 * math.pi), math.floor(2 * math.pi * 50)
    assert (first, last) == (6, 314)
    # Between pixels the radius is interpolated: curved near the centre, straight farther out.
    assert radii[-last:] == pytest.approx(np.full(last, 50.0), abs=0.05)
    assert radii[:first] == pytest.approx(np.ones(first), abs=0.5)


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.0])
def test_sampling_turns_the_content_by_the_heading(yaw: float) -> None:
    """What stands at image angle a stands at a + yaw once turned: sample k of a circle shows angle k - yaw."""
    count = 314
    angles = np.arange(count) * 2 * math.pi / count
    assert sample_circles(field("u"), yaw)[-count:] == pytest.approx(50.0 * np.cos(angles - yaw), abs=0.05)
    assert sample_circles(field("v"), yaw)[-count:] == pytest.approx(50.0 * np.sin(angles - yaw), abs=0.05)


def test_the_gradient_is_unnormalised_sobel() -> None:
    """A ramp of 2 grey values a small pixel: 3x3 Sobel gives 8 times that slope."""
    ramp = np.repeat(np.arange(640)[None] / 4 * 1.5, 480, 0)
    image = np.clip(np.rint(ramp), 0, 255).astype(np.uint8)[..., None].repeat(3, -1)
    magnitude = gradient_magnitude(image)
    assert magnitude.shape == (120, 160)
    assert magnitude[20:100, 20:140].mean() == pytest.approx(8 * 1.5, rel=0.02)


def test_the_vector_does_not_depend_on_the_robots_heading() -> None:
    room = room_with_tiles()
    perceiver = Perceiver(CameraModel.equidistant(640, 480, math.radians(190.0)))
    here, turned, elsewhere = (
        perceiver.perceive(Frame(0.0, room.render(x, 0.4, yaw, 0.0)), Pose2D())
        for x, yaw in ((0.2, 0.3), (0.2, -1.9), (1.0, 0.3))
    )
    assert here is not None
    assert turned is not None
    assert elsewhere is not None
    same = np.linalg.norm(here.vector - turned.vector)
    assert same < 0.5 * np.linalg.norm(here.vector - elsewhere.vector)


def test_without_a_compass_there_is_no_perception_until_the_tiles_are_seen() -> None:
    room = room_with_tiles()
    perceiver = Perceiver(CameraModel.equidistant(640, 480, math.radians(190.0)))
    dark = Frame(0.0, np.zeros((480, 640, 3), np.uint8))
    assert perceiver.perceive(dark, Pose2D()) is None
    perceiver.perceive(Frame(0.0, room.render(0.0, 0.0, 0.2, 0.0)), Pose2D())
    carried = perceiver.perceive(dark, Pose2D(yaw=0.1))
    assert carried is not None
    assert not carried.heading.seen
    perceiver.reset()
    assert perceiver.perceive(dark, Pose2D()) is None
