"""The rooms to tune and to report on: their light, what sets halls apart, that every one of them renders."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from tools.sim import ceilings, reporting
from tools.sim.lens import Sensor
from tools.sim.lighting import LIGHTS
from tools.sim.world import World
from tools.sim.world_plugin import load_world

ROOMS = [
    ceilings.tiles,
    ceilings.plain,
    ceilings.beams,
    reporting.slats,
    reporting.ducts,
    reporting.coffers,
    reporting.office,
    reporting.attic,
    reporting.clinic,
    reporting.gallery,
    reporting.workshop,
    reporting.parlour,
]
HALLS = [ceilings.hall, reporting.hall]
PIXEL = 240.0 / math.radians(95.0)  # px a radian
V, U = np.mgrid[:480, :640]
ZENITH_ANGLE = np.hypot(U - 319.5, V - 239.5) / PIXEL


@functools.lru_cache(maxsize=12)  # a room takes 20 to 60 MB
def made(factory: Callable[..., World], seed: int, light: str = "nominal") -> World:
    return factory(seed, light=light)


def grey(world: World, x: float = 0.3, y: float = -0.2) -> np.ndarray:
    """From the middle of the room, less most of the noise."""
    return cv2.GaussianBlur(world.render(x, y, 0.4, 7.0), (0, 0), 1.0).mean(axis=2)


def name_of(factory: object) -> str:
    return f"{factory.__module__.split('.')[-1]}.{factory.__name__}"


@pytest.mark.parametrize("factory", ROOMS, ids=name_of)
def test_every_light_makes_another_picture_of_the_same_room(factory):
    seen = {light: grey(factory(5, light=light)) for light in LIGHTS}
    for light in LIGHTS[1:]:
        assert np.abs(seen[light] - seen["nominal"]).mean() > 1.0, light
    inside = math.radians(80.0) > ZENITH_ANGLE
    means = {light: picture[inside].mean() for light, picture in seen.items()}
    assert means["night"] < 0.75 * means["nominal"]
    assert means["night"] > 15.0  # still something to see
    assert seen["night"][inside].std() > 4.0


def test_unknown_light_is_refused_by_name():
    with pytest.raises(ValueError, match=r"'dusk'.*nominal.*night"):
        ceilings.beams(0, light="dusk")


def saturated(world: World) -> int:
    """Pixels of the ceiling as bright as only lamps are."""
    return int((world.render(0.0, 0.0, 0.0, 0.0)[120:360, 200:440] > 250).all(axis=2).sum())


def test_lamps_shine_or_do_not():
    lit = {light: saturated(made(ceilings.tiles, 5, light)) for light in LIGHTS}
    assert lit["nominal"] > 300
    assert 0 < lit["half_lamps"] < lit["nominal"]
    assert lit["lamps_off"] == lit["night"] == 0


def ceiling_at(world: World, x: float, y: float) -> float:
    """Mean grey of the ceiling 2.7 m up around (x, y), seen from the origin."""
    theta, bearing = math.atan2(math.hypot(x, y), 2.2), math.atan2(y, x)
    u, v = round(319.5 + PIXEL * theta * math.sin(bearing)), round(239.5 - PIXEL * theta * math.cos(bearing))
    return float(world.render(0.0, 0.0, 0.0, 0.0)[v - 4 : v + 5, u - 4 : u + 5].mean())


def test_sun_lights_a_patch_of_the_ceiling_and_little_else():
    nominal, sun = (made(ceilings.plain, 5, light) for light in ("nominal", "sun"))
    assert ceiling_at(sun, -1.7, -1.4) - ceiling_at(nominal, -1.7, -1.4) > 40
    assert abs(ceiling_at(sun, 1.7, 1.4) - ceiling_at(nominal, 1.7, 1.4)) < 30


def test_the_patch_of_sun_creeps_along_the_walls():
    """A patch 1.2 m wide; after 50 minutes it has left where it was, after one second it has not."""
    world = made(ceilings.plain, 5, "sun")
    gain = [world._sensor.gain(t) for t in (0.0, 1.0, 3000.0)]
    first, soon, late = (world.render(0.0, 0.0, 0.0, t) / g for t, g in zip((0.0, 1.0, 3000.0), gain, strict=True))
    walls = (math.radians(60.0) < ZENITH_ANGLE) & (math.radians(92.0) > ZENITH_ANGLE)

    def changed(other: np.ndarray) -> int:
        return int((np.abs(cv2.GaussianBlur(other - first, (0, 0), 2.0).mean(axis=2)) > 15.0)[walls].sum())

    assert changed(soon) == 0
    assert changed(late) > 500
    assert np.array_equal(world.render(0.0, 0.0, 0.0, 0.0), ceilings.plain(5, light="sun").render(0.0, 0.0, 0.0, 0.0))


def test_by_day_without_lamps_the_ceiling_is_brighter_near_the_windows():
    world = made(ceilings.plain, 5, "lamps_off")
    strip = world.surfaces.walls.astype(float).mean(axis=2)
    column = int(strip[60:110].max(axis=0).argmax())  # a pane: nothing else on the walls is as bright
    along = column / 64.0
    x, y = [(along - 3, -3), (3, along - 9), (15 - along, 3), (-3, 21 - along)][int(along // 6)]
    assert ceiling_at(world, 0.85 * x, 0.85 * y) > ceiling_at(world, 0.0, 0.0) + 10.0


def test_by_night_there_is_more_noise():
    world = made(ceilings.plain, 5, "night")
    a, b = (world.render(0.0, 0.0, yaw, 3.0).astype(float) for yaw in (0.0, 1e-9))
    spread = (a - b)[140:340, 220:420].std() / math.sqrt(2.0)
    assert 1.8 * Sensor.NOISE < spread < 3.0 * Sensor.NOISE


@pytest.mark.parametrize("factory", HALLS, ids=name_of)
def test_a_hall_repeats_itself_except_at_the_rim(factory):
    world = made(factory, 5)
    pitch = 1.8 if factory is reporting.hall else pitch_of(world)
    here, cell_on, between = (grey(world, x) for x in (-0.6, -0.6 + pitch, -0.6 + 0.5 * pitch))
    inner, rim = (
        math.radians(50.0) > ZENITH_ANGLE,
        (math.radians(62.0) < ZENITH_ANGLE) & (math.radians(92.0) > ZENITH_ANGLE),
    )
    assert np.abs(cell_on - here)[inner].mean() < 1.5
    assert np.abs(cell_on - here)[rim].mean() > 6.0
    assert np.abs(between - here)[inner].mean() > 6.0


def test_the_lattice_of_a_halls_lamps_lies_elsewhere_with_another_seed():
    textures = [made(reporting.hall, seed).surfaces.ceiling.astype(int) for seed in (5, 6)]
    assert np.abs(textures[0] - textures[1]).mean() > 5.0


def pitch_of(world: World) -> float:
    """Distance of the lamps in the ceiling's texture, m."""
    bright = (world.surfaces.ceiling.min(axis=2) > 150).astype(np.uint8)
    _, _, stats, centres = cv2.connectedComponentsWithStats(bright)
    whole = centres[1:][stats[1:, cv2.CC_STAT_AREA] > 0.9 * stats[1:, cv2.CC_STAT_AREA].max()] / 100.0
    apart = np.hypot(*(whole - whole[0]).T)
    return float(np.min(apart[apart > 0.1]))


@pytest.mark.parametrize("factory", [*ROOMS[3:], *HALLS], ids=name_of)
def test_room_and_picture_depend_on_the_seed_alone(factory):
    name = f"{factory.__module__}:{factory.__name__}"
    first, again, other = made(factory, 5), load_world(name, 5), made(factory, 6)
    picture = first.render(0.3, -0.2, 0.4, 7.0)
    assert np.array_equal(picture, again.render(0.3, -0.2, 0.4, 7.0))
    assert cv2.absdiff(picture, other.render(0.3, -0.2, 0.4, 7.0)).mean() > 5.0
    inside = picture[math.radians(80.0) > ZENITH_ANGLE]
    assert 30 < inside.mean() < 200
    assert inside.std() > 15


def test_reporting_rooms_differ_in_size_and_camera():
    worlds = [made(factory, 5) for factory in ROOMS[3:]]
    assert len({world.bounds for world in worlds}) == len(worlds)
    assert len({world.room.height for world in worlds}) >= len(worlds) - 1
    assert {world.fov_deg for world in worlds} == {180.0, 185.0, 190.0}
    assert sum(world.camera_info is not None for world in worlds) == 2
