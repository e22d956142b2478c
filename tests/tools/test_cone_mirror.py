"""Pictures of a conical mirror checked, for single bright spots, against the closed form of the aligned cone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.optics.rigid import Rigid
from tools.sim.cone_mirror import ConeMirror, upright
from tools.sim.lens import Lens
from tools.sim.room import CEILING_SCALE, WALL_FOOT, WALL_SCALE, Bar, Bars, Recess, Surfaces
from tools.sim.world import World

SIDE, CEILING = 6.0, 2.7
POSES = [(0.0, 0.0, 0.0), (1.2, -0.7, 0.9), (-0.8, 1.0, -2.6)]
WIDTH, ROWS = 320, 240
LENS = 0.10  # m from the tip
FOCAL = (LENS / 0.05 + 1.0) * 0.48 * ROWS
TINY_LENS = Lens(64, 48, radius=24.0)  # of the fisheye camera, which is not used here


def black(rows: float, columns: float, scale: float) -> np.ndarray:
    return np.zeros((round(rows * scale), round(columns * scale), 3), np.uint8)


def spot(image: np.ndarray, x: float, y: float, scale: float, size: float = 0.1) -> np.ndarray:
    """A white square of `size` m centred at (x, y) metres from the texture's corner."""
    r0, r1, c0, c1 = (round(v * scale) for v in (y - size / 2, y + size / 2, x - size / 2, x + size / 2))
    image[r0:r1, c0:c1] = 255
    return image


def dark(**given: object) -> World:
    parts: dict[str, object] = {
        "ceiling": black(SIDE, SIDE, CEILING_SCALE),
        "walls": black(CEILING + WALL_FOOT, 4 * SIDE, WALL_SCALE),
    }
    return World(Surfaces(**(parts | given)), seed=0, lens=TINY_LENS)  # type: ignore[arg-type]


def brightest(picture: np.ndarray) -> np.ndarray:
    """Centre (u, v) of what is well above the noise."""
    grey = picture.mean(axis=2)
    v, u = np.nonzero(grey > 25)
    assert len(u), "nothing bright in the picture"
    weight = grey[v, u]
    return np.array([np.average(u, weights=weight), np.average(v, weights=weight)])


def expected(point: tuple[float, float, float], pose: tuple[float, float, float], tip: float) -> np.ndarray:
    """Pixel of a world point by h = v z / (r + d), section 2.2.1; the tip points down."""
    dx, dy = point[0] - pose[0], point[1] - pose[1]
    out = FOCAL * (point[2] - tip) / (math.hypot(dx, dy) + LENS)
    bearing = math.atan2(dy, dx) - pose[2]
    return np.array([(WIDTH - 1) / 2, (ROWS - 1) / 2]) + out * np.array([math.cos(bearing), math.sin(bearing)])


def mirror(world: World, tip: float) -> ConeMirror:
    return ConeMirror(world, upright(tip, WIDTH, ROWS), WIDTH, ROWS)


WALL_SPOTS = {  # metres along the strip, counter-clockwise from (-3, -3): the point 1.2 m above the floor
    2.0: (-1.0, -3.0, 1.2),
    8.5: (3.0, -0.5, 1.2),
    14.0: (1.0, 3.0, 1.2),
    19.5: (-3.0, 1.5, 1.2),
}


@pytest.mark.parametrize("along", WALL_SPOTS)
def test_walls(along: float) -> None:
    walls = spot(black(CEILING + WALL_FOOT, 4 * SIDE, WALL_SCALE), along, CEILING - 1.2, WALL_SCALE, 0.0625)
    seen = mirror(dark(walls=walls), 0.9)
    for pose in POSES:
        assert np.hypot(*(brightest(seen.render(*pose, 0.0)) - expected(WALL_SPOTS[along], pose, 0.9))) < 0.5


def test_ceiling() -> None:
    ceiling = spot(black(SIDE, SIDE, CEILING_SCALE), 1.0, 1.5, CEILING_SCALE, 0.2)
    pose = (0.6, 0.4, 1.1)
    picture = mirror(dark(ceiling=ceiling), 2.3).render(*pose, 0.0)
    assert np.hypot(*(brightest(picture) - expected((-2.0, -1.5, CEILING), pose, 2.3))) < 0.7


def test_the_top_of_a_recess_is_higher() -> None:
    area = (-2.8, -2.4, 0.2, 0.6)
    top = spot(black(3.0, 3.0, CEILING_SCALE), 0.5, 1.0, CEILING_SCALE, 0.2)
    recess = Recess(area, 0.2, top, black(0.2, 12.0, WALL_SCALE))
    pose = (1.4, 0.4, -0.4)
    picture = mirror(dark(recesses=(recess,)), 2.3).render(*pose, 0.0)
    assert np.hypot(*(brightest(picture) - expected((-2.3, -1.4, CEILING + 0.2), pose, 2.3))) < 0.9


def test_the_near_flank_of_a_bar_is_seen_and_hides_the_wall() -> None:
    flank = spot(black(0.3, SIDE, CEILING_SCALE), 2.0, 0.15, CEILING_SCALE, 0.1)
    bars = Bars("y", (Bar((1.8, 2.1), 0.3, flank),), black(SIDE, SIDE, CEILING_SCALE))
    walls = black(CEILING + WALL_FOOT, 4 * SIDE, WALL_SCALE)
    walls[: round(0.15 * WALL_SCALE), round(6.1 * WALL_SCALE) : round(11.9 * WALL_SCALE)] = 255  # east, behind the bar
    pose = (0.0, 0.3, 0.2)
    picture = mirror(dark(walls=walls, bars=(bars,)), 2.2).render(*pose, 0.0)
    assert np.hypot(*(brightest(picture) - expected((1.8, -1.0, CEILING - 0.15), pose, 2.2))) < 0.7


def test_a_crooked_mirror_is_drawn_as_it_projects() -> None:
    walls = spot(black(CEILING + WALL_FOOT, 4 * SIDE, WALL_SCALE), 8.5, CEILING - 1.2, WALL_SCALE)
    level = upright(0.9, WIDTH, ROWS)
    camera = Rigid.of((0.03, -0.05, 0.4), (0.004, -0.003, 0.105))
    sensor = replace(level, cone_from_camera=camera)
    picture = ConeMirror(dark(walls=walls), sensor, WIDTH, ROWS).render(0.0, 0.0, 0.0, 0.0)
    at = sensor.pixels(np.array([[3.0, -0.5, 1.2]]))[0]
    assert np.hypot(*(at - level.pixels(np.array([[3.0, -0.5, 1.2]]))[0])) > 5.0
    assert np.hypot(*(brightest(picture) - at)) < 0.5


def test_the_same_shot_is_the_same_picture() -> None:
    seen = mirror(dark(), 0.9)
    first, again, later = (seen.render(0.1, 0.2, 0.3, t) for t in (0.0, 0.0, 1.0))
    assert first.shape == (ROWS, WIDTH, 3)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, later)
