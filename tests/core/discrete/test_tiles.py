"""Bearings of floor tiles, and their names from picture to picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from omnibotd.core.discrete.tiles import TileTracker, bearings
from omnibotd.core.geometry import Pose2D, wrap
from tools.sim.floor_camera import ARENA, OUTSIDE, FloorCamera

CENTRE = (320.0, 240.0)
CORNERS = [(x * (ARENA[0] / 2 + OUTSIDE), y * (ARENA[1] / 2 + OUTSIDE)) for x in (-1, 1) for y in (-1, 1)]


@pytest.fixture(scope="module")
def camera() -> FloorCamera:
    return FloorCamera(1)


def picture(*tiles: tuple[int, int], side: int = 10) -> np.ndarray:
    """Blue squares about pixels (u, v)."""
    image = np.full((480, 640, 3), (70, 105, 135), np.uint8)
    for u, v in tiles:
        image[v - side // 2 : v + side // 2 + 1, u - side // 2 : u + side // 2 + 1] = (205, 60, 30)
    return image


FOUR = ((320, 100), (150, 240), (320, 400), (500, 240))  # ahead, left, behind, right


@pytest.mark.parametrize(
    ("tile", "degrees"), [((320, 140), 0.0), ((220, 240), 90.0), ((420, 240), -90.0), ((220, 140), 45.0)]
)
def test_image_left_of_a_floor_camera_is_left(tile: tuple[int, int], degrees: float) -> None:
    assert bearings(np.array([tile], float), CENTRE) == pytest.approx([math.radians(degrees)])


def test_tiles_are_named_counter_clockwise_from_ahead() -> None:
    seen = TileTracker(CENTRE).begin(picture(*FOUR))
    assert seen is not None
    assert np.degrees(seen) % 360.0 == pytest.approx([0.0, 90.0, 180.0, 270.0], abs=0.5)


def test_names_stay_on_the_tiles_while_the_robot_turns(camera: FloorCamera) -> None:
    tracker = TileTracker((319.5, 239.5))
    tracker.begin(camera.render(Pose2D(0.3, -0.2, 0.0)))
    for degrees in range(15, 361, 15):
        seen = tracker.see(camera.render(Pose2D(0.3, -0.2, math.radians(degrees))))
    assert seen is not None
    first = tracker.begin(camera.render(Pose2D(0.3, -0.2, 0.0)))
    assert seen == pytest.approx(first, abs=math.radians(0.5))


def test_a_hidden_tile_leaves_no_perception_and_no_new_names() -> None:
    tracker = TileTracker(CENTRE)
    before = tracker.begin(picture(*FOUR))
    assert tracker.see(picture(*FOUR[1:])) is None
    assert tracker.see(picture(*FOUR)) == pytest.approx(before)


def test_tiles_that_jump_are_not_taken_for_others() -> None:
    tracker = TileTracker(CENTRE)
    tracker.begin(picture(*FOUR))
    assert tracker.see(picture((450, 110), (200, 110), (190, 370), (450, 370))) is None


def test_before_they_are_named_nothing_is_perceived() -> None:
    assert TileTracker(CENTRE).see(picture(*FOUR)) is None


def test_other_blue_things_are_smaller() -> None:
    image = picture(*FOUR)
    image[300:304, 200:204] = (205, 60, 30)
    seen = TileTracker(CENTRE).begin(image)
    assert seen is not None
    assert seen == pytest.approx(TileTracker(CENTRE).begin(picture(*FOUR)))


@pytest.mark.parametrize("pose", [Pose2D(0.0, 0.0, 0.0), Pose2D(1.2, 1.05, 2.4), Pose2D(-1.1, 0.4, -1.0)])
def test_rendered_tiles_are_seen_where_they_are(pose: Pose2D, camera: FloorCamera) -> None:
    seen = TileTracker(camera.centre).begin(camera.render(pose))
    assert seen is not None
    true = [math.atan2(y - pose.y, x - pose.x) - pose.yaw for x, y in CORNERS]
    off = [min(abs(wrap(angle - one)) for one in true) for angle in seen]
    assert max(off) < math.radians(0.5)
