"""The thesis' compasses on panoramas that turn exactly, and where they must say that they can't tell."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from omnibotd.core.compass.image_flow import ImageFlow, displacement
from omnibotd.core.compass.labrosse import Labrosse, ReferenceLabrosse
from omnibotd.core.compass.round_view import Levelling, Ring, RoundView
from omnibotd.core.compass.turn import Compass
from omnibotd.core.compass.two_point import TwoPointFlow
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

RING = Ring(119.5, 119.5, inner=15.0, outer=110.0)
CROSSING = (0.15, 0.4)  # rad a pixel: edges in two directions near each other
DEGREES = [0.05, 0.3, 1.0, 2.0, -0.7]


def panorama(heading: float, ring: Ring = RING, slants: tuple[float, float] = (-0.08, 0.08)) -> RoundView:
    """Waves in bearing and radius, seen by a robot of this heading."""
    v, u = np.mgrid[0:240, 0:240].astype(float)
    bearing, radius = ring.bearings(u, v) + heading, np.hypot(u - ring.u, v - ring.v)
    rng, grey = np.random.default_rng(4), np.full(u.shape, 128.0)
    for cycles in (2, 3, 5, 8, 11):
        phase, slant, size = rng.uniform(0, math.tau), rng.uniform(*slants) * (-1) ** cycles, rng.uniform(12, 22)
        grey += size * np.sin(cycles * bearing + slant * radius + phase)
    return RoundView(np.clip(np.rint(grey), 0, 255).astype(np.uint8), ring)


@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("make", [ImageFlow, Labrosse, ReferenceLabrosse])
def test_a_turn_is_told_to_a_thirtieth_of_a_degree(make: type[Compass], degrees: float) -> None:
    turn = make().turn(panorama(1.0), panorama(1.0 + math.radians(degrees)))
    assert turn.ok
    assert math.degrees(turn.angle) == pytest.approx(degrees, abs=0.03)  # 0.027 with OpenCV 4.6


@pytest.mark.parametrize("degrees", [0.1, 0.3, 0.6, -0.5])
def test_two_point_flow_tells_a_turn_to_a_tenth(degrees: float) -> None:
    before, now = (panorama(heading, slants=CROSSING) for heading in (1.0, 1.0 + math.radians(degrees)))
    turn = TwoPointFlow().turn(before, now)
    assert turn.support > 100
    assert math.degrees(turn.angle) == pytest.approx(degrees, rel=0.1)


@pytest.mark.parametrize("compass", [TwoPointFlow(), ImageFlow(), Labrosse()])
@pytest.mark.parametrize("ring", [Ring(119.5, 119.5, 15.0, 110.0, front=2.0), Ring(119.5, 119.5, 15.0, 110.0, 0.5, -1)])
def test_front_and_sense_of_the_picture_do_not_matter(compass: Compass, ring: Ring) -> None:
    before, now = (panorama(heading, ring, CROSSING) for heading in (0.0, math.radians(0.5)))
    assert math.degrees(compass.turn(before, now).angle) == pytest.approx(0.5, rel=0.2)


@pytest.mark.parametrize("compass", [TwoPointFlow(), ImageFlow(), Labrosse(), ReferenceLabrosse()])
def test_a_flat_picture_says_nothing(compass: Compass) -> None:
    flat = RoundView(np.full((240, 240), 90, np.uint8), RING)
    turn = compass.turn(flat, flat)
    assert not turn.ok
    assert turn.angle == 0.0


def test_labrosse_looks_all_round_where_the_best_is_at_the_end_of_its_range() -> None:
    turn = Labrosse().turn(panorama(0.0), panorama(math.radians(12.0)))
    assert math.degrees(turn.angle) == pytest.approx(12.0, abs=0.06)


def test_a_reference_carries_a_turn_over_many_frames() -> None:
    compass, headings = ReferenceLabrosse(), np.radians(np.arange(0.0, 8.0, 0.33))
    views = [panorama(float(heading)) for heading in headings]
    turned = sum(compass.turn(before, now).angle for before, now in pairwise(views))
    assert math.degrees(turned) == pytest.approx(math.degrees(headings[-1]), abs=0.15)  # three twentieths of a column


def test_displacement_follows_the_definition() -> None:
    """before(x + h) = now(x) for the specification's own example of 0.37 bins."""
    x = np.arange(61.0)
    result = displacement(
        50 * np.sin(x / 7.0) + 20 * np.cos(x / 3.0), 50 * np.sin((x + 0.37) / 7.0) + 20 * np.cos((x + 0.37) / 3.0)
    )
    assert result.converged
    assert result.bins == pytest.approx(0.37, abs=0.01)


@pytest.mark.parametrize("yaw", [0.0, 0.8])
def test_levelling_undoes_tilt_and_mounting(yaw: float) -> None:
    """A bright spot appears where its ray's bearing and zenith angle say, however the camera stands."""
    zenith, bearing = math.radians(40.0), 1.1
    ray = [math.sin(zenith) * math.cos(bearing), math.sin(zenith) * math.sin(bearing), math.cos(zenith)]
    camera = CameraModel(640, 480, 144.7, 144.7, 330.0, 231.0, mount_yaw=yaw, tilt=(0.1, -0.05))
    v, u = np.mgrid[0:480, 0:640]
    at = camera.project(ray)
    spot = (255 * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 18.0)).astype(np.uint8)
    view = Levelling(camera)(Frame(0.0, spot))
    total = view.grey.astype(float)
    rows, columns = np.mgrid[0 : total.shape[0], 0 : total.shape[1]]
    u_seen, v_seen = (float((total * axis).sum() / total.sum()) for axis in (columns, rows))
    assert u_seen - view.ring.u == pytest.approx(144.7 * zenith * math.cos(bearing), abs=0.5)
    assert v_seen - view.ring.v == pytest.approx(144.7 * zenith * math.sin(bearing), abs=0.5)
