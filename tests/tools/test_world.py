"""The simulated room: pictures checked against geometry worked out here, by hand, for single bright spots."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from omnibotd.core.vision.camera_model import CameraModel
from tools.sim import ceilings, panorama
from tools.sim.lens import Lens
from tools.sim.room import CEILING_SCALE, WALL_FOOT, WALL_SCALE, Bar, Bars, Recess, Room, Surfaces
from tools.sim.world import World

SIDE, CEILING = 6.0, 2.7
POSES = [(0.0, 0.0, 0.0), (1.2, -0.7, 0.9), (-1.9, 1.4, -2.6), (0.4, 2.0, math.pi / 2)]
F = 240.0 / math.radians(95.0)
CENTRE = (319.5, 239.5)


def black(rows: float, columns: float, scale: float) -> np.ndarray:
    return np.zeros((round(rows * scale), round(columns * scale), 3), np.uint8)


def spot(image: np.ndarray, x: float, y: float, scale: float, size: float = 0.1) -> np.ndarray:
    """A white square of `size` m centred at (x, y) metres from the texture's corner."""
    r0, r1, c0, c1 = (round(v * scale) for v in (y - size / 2, y + size / 2, x - size / 2, x + size / 2))
    image[r0:r1, c0:c1] = 255
    return image


def dark_room(
    ceiling: np.ndarray | None = None,
    walls: np.ndarray | None = None,
    bars: tuple[Bars, ...] = (),
    recesses: tuple[Recess, ...] = (),
) -> World:
    above = black(SIDE, SIDE, CEILING_SCALE) if ceiling is None else ceiling
    around = black(CEILING + WALL_FOOT, 4 * SIDE, WALL_SCALE) if walls is None else walls
    return World(Surfaces(above, around, bars, recesses), seed=0)


def brightest(picture: np.ndarray) -> np.ndarray:
    """Centre (u, v) of what is well above the noise."""
    grey = picture.mean(axis=2)
    v, u = np.nonzero(grey > 40)
    assert len(u), "nothing bright in the picture"
    weight = grey[v, u]
    return np.array([np.average(u, weights=weight), np.average(v, weights=weight)])


def expected(point: tuple[float, float, float], pose: tuple[float, float, float]) -> np.ndarray:
    """Pixel of a world point, from the equidistant lens equation alone."""
    dx, dy, dz = point[0] - pose[0], point[1] - pose[1], point[2] - 0.5
    theta = math.atan2(math.hypot(dx, dy), dz)
    bearing = math.atan2(dy, dx) - pose[2]
    return np.array([CENTRE[0] + F * theta * math.sin(bearing), CENTRE[1] - F * theta * math.cos(bearing)])


def test_what_is_to_the_robots_left_is_on_the_right_of_the_picture():
    world = dark_room(spot(black(SIDE, SIDE, CEILING_SCALE), 3.0, 4.0, CEILING_SCALE))
    u, v = brightest(world.render(0.0, 0.0, 0.0, 0.0))
    assert u > 360
    assert abs(v - 239.5) < 1.0


@pytest.mark.parametrize("pose", POSES)
def test_lamp_on_the_ceiling_appears_where_geometry_puts_it(pose):
    world = dark_room(spot(black(SIDE, SIDE, CEILING_SCALE), 3.7, 3.4, CEILING_SCALE))
    found = brightest(world.render(*pose, 0.0))
    assert np.hypot(*(found - expected((0.7, 0.4, 2.7), pose))) < 0.5


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize(
    ("along", "point"),
    [(2.0, (-1.0, -3.0, 1.5)), (8.5, (3.0, -0.5, 1.5)), (13.0, (2.0, 3.0, 1.5)), (22.0, (-3.0, -1.0, 1.5))],
)
def test_spot_on_each_wall_appears_where_geometry_puts_it(pose, along, point):
    world = dark_room(walls=spot(black(CEILING + WALL_FOOT, 24.0, WALL_SCALE), along, 1.2, WALL_SCALE, 0.125))
    found = brightest(world.render(*pose, 0.0))
    assert np.hypot(*(found - expected(point, pose))) < 0.7


def beam_room(underside: np.ndarray, ceiling: np.ndarray | None = None, flank_value: int = 0) -> World:
    flank = np.full((25, round(SIDE * CEILING_SCALE), 3), flank_value, np.uint8)
    return dark_room(ceiling, bars=(Bars("y", (Bar((0.9, 1.1), 0.25, flank),), underside),))


@pytest.mark.parametrize("pose", POSES)
def test_spot_under_a_beam_has_the_parallax_of_its_height(pose):
    world = beam_room(spot(black(SIDE, SIDE, CEILING_SCALE), 4.0, 2.5, CEILING_SCALE))
    found = brightest(world.render(*pose, 0.0))
    assert np.hypot(*(found - expected((1.0, -0.5, 2.45), pose))) < 0.5


def test_a_beam_hides_the_ceiling_behind_it_and_only_that():
    """From x = 0 the beam's lower edge at 1.1 hides the ceiling from 0.9 to 1.1 * 2.2 / 1.95 = 1.241."""
    under = black(SIDE, SIDE, CEILING_SCALE)
    seen = {}
    for x in (0.8, 1.15, 1.35):
        ceiling = spot(black(SIDE, SIDE, CEILING_SCALE), 3.0 + x, 3.0, CEILING_SCALE, 0.06)
        seen[x] = bool((beam_room(under, ceiling).render(0.0, 0.0, 0.0, 0.0).max(axis=2) > 60).any())
    assert seen == {0.8: True, 1.15: False, 1.35: True}


def test_the_flank_seen_is_the_one_that_faces_the_robot():
    """From x = 0: from the underside's edge (0.9 m across, 1.95 m up) to the ceiling (0.9 across, 2.2 up)."""
    picture = beam_room(black(SIDE, SIDE, CEILING_SCALE), flank_value=255).render(0.0, 0.0, 0.0, 0.0)
    rows = np.flatnonzero(picture[:, 320].max(axis=1) > 100)
    assert abs(rows.max() - (239.5 - F * math.atan2(0.9, 2.2))) < 1.5
    assert abs(rows.min() - (239.5 - F * math.atan2(0.9, 1.95))) < 1.5


@pytest.mark.parametrize("pose", POSES)
def test_spot_on_the_flank_of_a_bar_along_x_appears_where_geometry_puts_it(pose):
    """The bar spans y from -2.3 to -2.1: every pose looks at its flank at y = -2.1, 0.1 m above its bottom."""
    flank = black(0.3, SIDE, CEILING_SCALE)
    flank[8:12, 348:352] = 255  # x from 0.48 to 0.52, 0.08 to 0.12 m up
    bar = Bar((-2.3, -2.1), 0.4, flank, top=0.1)
    world = dark_room(bars=(Bars("x", (bar,), black(SIDE, SIDE, CEILING_SCALE)),))
    found = brightest(world.render(*pose, 0.0))
    assert np.hypot(*(found - expected((0.5, -2.1, 2.4), pose))) < 0.7


def test_the_lower_of_two_crossing_bars_hides_the_higher():
    plane = np.full((600, 600, 3), 255, np.uint8)
    flank = black(0.1, SIDE, CEILING_SCALE)
    high = Bars("y", (Bar((-0.3, 0.3), 0.2, flank, top=0.1),), plane)
    low = Bars("x", (Bar((-0.3, 0.3), 0.5, flank, top=0.4),), black(SIDE, SIDE, CEILING_SCALE))
    for order in ((high, low), (low, high)):
        picture = dark_room(bars=order).render(0.0, 0.0, 0.0, 0.0)
        assert picture[239, 319].max() < 20  # the dark one, straight above
        beyond = np.rint(expected((0.0, 1.2, 2.5), (0.0, 0.0, 0.0))).astype(int)
        assert picture[beyond[1], beyond[0]].min() > 200


@pytest.mark.parametrize("pose", POSES)
def test_spot_on_the_top_of_a_recess_has_the_parallax_of_its_height(pose):
    top = spot(black(4.0, 4.0, CEILING_SCALE), 2.2, 1.7, CEILING_SCALE)
    sides = black(0.3, 16.0, WALL_SCALE)
    world = dark_room(recesses=(Recess((-2.0, -2.0, 2.0, 2.0), 0.3, top, sides),))
    found = brightest(world.render(*pose, 0.0))
    assert np.hypot(*(found - expected((0.2, -0.3, 3.0), pose))) < 0.5


def test_spot_on_the_side_of_a_recess_is_seen_from_below_it_only():
    """On the side at x = 1, 0.15 m above the ceiling: hidden by the edge from x = 2 on the other side of it."""
    sides = spot(black(0.3, 8.0, WALL_SCALE), 2.0 + 1.2, 0.15, WALL_SCALE, 0.125)  # the east side starts at 2 m
    recess = Recess((-1.0, -1.0, 1.0, 1.0), 0.3, black(2.0, 2.0, CEILING_SCALE), sides)
    world = dark_room(recesses=(recess,))
    found = brightest(world.render(-0.4, 0.1, 0.3, 0.0))
    assert np.hypot(*(found - expected((1.0, 0.2, 2.85), (-0.4, 0.1, 0.3)))) < 0.7
    assert world.render(2.0, 0.0, 0.0, 0.0).max() < 20


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (2.9, -1.7, 0.9), (-3.2, 1.4, -2.6)])
def test_rooms_of_other_size_height_and_lens_keep_their_geometry(pose):
    """7 x 4 x 3.1 m, 170 degrees, axis 11 px right of and 7 px above the centre; a spot on the north wall."""
    room, lens = Room(7.0, 4.0, 3.1), Lens(fov_deg=170.0, radius=220.0, offset=(11.0, -7.0))
    walls = spot(black(3.1 + WALL_FOOT, 22.0, WALL_SCALE), 11.0 + 3.0, 0.75, WALL_SCALE, 0.125)
    world = World(Surfaces(black(4.0, 7.0, CEILING_SCALE), walls), 0, lens, room)
    point = np.array([0.5, 2.0, 3.1 - 0.75])  # 3 m from the north-east corner
    assert world.bounds == (-3.5, -2.0, 3.5, 2.0)
    dx, dy = point[:2] - pose[:2]
    theta, bearing = math.atan2(math.hypot(dx, dy), point[2] - 0.5), math.atan2(dy, dx) - pose[2]
    r = 220.0 * theta / math.radians(85.0)
    wanted = np.array([330.5 + r * math.sin(bearing), 232.5 - r * math.cos(bearing)])
    assert np.hypot(*(brightest(world.render(*pose, 0.0)) - wanted)) < 0.7
    model = CameraModel.from_camera_info(world.camera_info, math.radians(170.0))
    ray = [math.sin(theta) * math.cos(bearing), math.sin(theta) * math.sin(bearing), math.cos(theta)]
    assert np.allclose(model.project(ray), wanted, atol=0.01)


@pytest.mark.parametrize("factory", [ceilings.tiles, ceilings.plain, ceilings.beams])
def test_room_and_picture_depend_on_the_seed_alone(factory):
    first, again, other = factory(5), factory(5), factory(6)
    picture = first.render(0.3, -0.2, 0.4, 7.0)
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert np.array_equal(picture, again.render(0.3, -0.2, 0.4, 7.0))
    assert cv2.absdiff(picture, other.render(0.3, -0.2, 0.4, 7.0)).mean() > 5.0


def test_noise_changes_from_shot_to_shot_and_stays_of_a_cameras_size():
    world = ceilings.plain(1)
    a, b = (world.render(0.0, 0.0, yaw, 3.0).astype(float) for yaw in (0.0, 1e-9))
    inner = np.s_[140:340, 220:420]
    spread = (a[inner] - b[inner]).std() / math.sqrt(2.0)
    assert 1.0 < spread < 3.0


def test_nothing_but_noise_outside_the_image_circle():
    picture = ceilings.tiles(1).render(0.0, 0.0, 0.0, 0.0)
    v, u = np.mgrid[:480, :640]
    outside = np.hypot(u - 319.5, v - 239.5) > 243
    assert 0 < picture[outside].max() < 16
    assert picture[~outside].mean() > 60


def test_rim_is_darker_and_exposure_drifts_a_little():
    grey = np.full((round(SIDE * CEILING_SCALE),) * 2 + (3,), 90, np.uint8)
    walls = np.full_like(black(CEILING + WALL_FOOT, 24.0, WALL_SCALE), 90)
    world = dark_room(grey, walls)
    picture = world.render(0.0, 0.0, 0.0, 0.0).astype(float)
    assert picture[235:245, 84:92].mean() < 0.85 * picture[235:245, 315:325].mean()
    means = [world.render(0.0, 0.0, 0.0, float(t))[200:280, 280:360].mean() for t in range(0, 60, 3)]
    assert 0.01 < np.std(means) / np.mean(means) < 0.06


def test_free_is_the_floor_less_the_robots_radius():
    world = ceilings.plain(0)
    xmin, ymin, xmax, ymax = world.bounds
    assert world.free(0.0, 0.0, 0.17)
    assert world.free(xmax - 0.18, ymin + 0.18, 0.17)
    assert not world.free(xmax - 0.16, 0.0, 0.17)
    assert not world.free(0.0, ymin + 0.16, 0.17)
    assert not world.free(xmin - 1.0, ymax + 1.0, 0.0)
    assert world.free(*world.dock[:2], 0.17)


def test_a_missing_photograph_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("OMNIBOT_DATA", str(tmp_path))
    with pytest.raises(panorama.PanoramaError, match=r"lobby\.hdr is missing: set OMNIBOT_DATA"):
        ceilings.photo(0)


def test_photograph_shows_the_point_above_the_robot_at_the_centre(monkeypatch, tmp_path):
    """A made photograph with marks that tell its zenith and its sense of turn."""
    picture = np.full((256, 512, 3), 0.2, np.float32)
    picture[:6] = 50.0  # 4 degrees round the zenith
    azimuth = 100  # a column; azimuth grows clockwise seen from above, so to the right in the photograph
    picture[84:88, azimuth - 3 : azimuth + 4] = 50.0  # zenith angle 60 degrees
    picture[84:88, azimuth + 40 : azimuth + 60] = 50.0  # to the right of it: clockwise, a longer dash
    (tmp_path / "ceilings_hdr").mkdir()
    cv2.imwrite(str(tmp_path / "ceilings_hdr" / "lobby.hdr"), picture)
    monkeypatch.setenv("OMNIBOT_DATA", str(tmp_path))
    seen = ceilings.photo(0).render(0.0, 0.0, 0.0, 0.0).max(axis=2)
    count, _, stats, centres = cv2.connectedComponentsWithStats((seen > 200).astype(np.uint8))
    blobs = sorted(range(1, count), key=lambda i: stats[i, cv2.CC_STAT_AREA])[-3:]
    away = {i: centres[i] - CENTRE for i in blobs}
    zenith, *marks = sorted(away, key=lambda i: np.hypot(*away[i]))
    assert np.hypot(*away[zenith]) < 1.5
    assert all(abs(np.hypot(*away[i]) - F * math.radians(60.5)) < 4.0 for i in marks)
    short, dash = sorted(marks, key=lambda i: stats[i, cv2.CC_STAT_AREA])
    # The dash lies clockwise of the short mark, seen from above; bearings count counter-clockwise.
    turn = math.atan2(away[dash][0], -away[dash][1]) - math.atan2(away[short][0], -away[short][1])
    assert math.degrees(math.remainder(turn, 2 * math.pi)) == pytest.approx(-49.5 * 360 / 512, abs=2.0)


@pytest.mark.skipif(
    not (panorama.data_folder() / "ceilings_hdr").exists(), reason="../shared/data/ceilings_hdr is absent"
)
def test_photographs_make_rooms_with_contrast():
    pictures = [ceilings.photo(seed).render(0.0, 0.0, 0.0, 0.0)[100:380, 180:460] for seed in range(2)]
    assert all(20 < p.mean() < 230 and p.std() > 8 for p in pictures)
    assert cv2.absdiff(*pictures).mean() > 10
