"""Rooms to report results on, FACTORY(seed, light) -> World as in ceilings.py. Nothing is ever tuned on these.

They differ in kind from those of ceilings.py: in what the ceiling is made of, in size and height, in what stands along
the walls, two of them in the lens.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tools.sim import materials, paint
from tools.sim.building import BarDesign, BarsDesign, Design, RecessDesign, build
from tools.sim.ceilings import periodic
from tools.sim.interior import furnished
from tools.sim.lens import Lens
from tools.sim.lighting import Lamp
from tools.sim.paint import Light
from tools.sim.room import CEILING_SCALE, WALL_SCALE, Room
from tools.sim.world import World

Area = tuple[float, float, float, float]


def slats(seed: int, light: str = "nominal") -> World:
    """Wooden boards with small spot lights, and a skylight in a white shaft: warm, dark, finely striped."""
    rng = np.random.default_rng((seed, 11))
    room = Room(5.6, 5.0, 2.5)
    albedo = materials.boards(rng, room, float(rng.uniform(0.09, 0.13)))
    spots = [Lamp(x + rng.normal(0.0, 0.08), y, 0.09) for x in (-2.0, -0.7, 0.7, 2.0) for y in (-1.6, 0.1, 1.7)]
    chosen = [spots[i] for i in sorted(rng.permutation(12)[:9])]
    x, y = rng.uniform(-1.4, 0.5), rng.uniform(-1.5, 0.6)
    interior = furnished(rng, room, ("door", "curtains", "shelf", "plant", "cupboard", "picture"))
    skylight = _recess((x, y, x + 0.9, y + 0.8), 0.35, 0.05, 0.8)
    paint.box(skylight.top, (0.43, 0.0, 0.47, 0.8), 0.3)
    return build(Design(albedo, chosen, interior, recesses=(replace(skylight, sky=1.3),)), seed, light)


def ducts(seed: int, light: str = "nominal") -> World:
    """An office left raw: an air duct, pipes and a cable tray at different heights under grey concrete."""
    rng = np.random.default_rng((seed, 12))
    room = Room(7.0, 6.0, 3.2)
    albedo = materials.concrete(rng, room)
    duct, pipes, tray = rng.uniform(-1.6, -0.8), rng.uniform(1.2, 2.0), rng.uniform(-1.2, 1.2)
    lamps = [Lamp(x, y, 0.16, 1.3) for x in (-2.6, 0.35, 2.9) for y in (-2.0, 0.4, 2.1)]
    chosen = [lamps[i] for i in sorted(rng.permutation(9)[:6])]
    interior = furnished(rng, room, ("door", "window", "lockers", "whiteboard", "cupboard", "radiator"))
    lengthwise = _metalwork(
        rng, room, "y", [(duct, 0.40, 0.50, 0.10), (pipes, 0.11, 0.30, 0.19), (pipes + 0.25, 0.07, 0.28, 0.21)]
    )
    crosswise = _metalwork(rng, room, "x", [(tray, 0.30, 0.62, 0.54), (tray + 2.1, 0.06, 0.12, 0.06)])
    return build(Design(albedo, chosen, interior, (lengthwise, crosswise)), seed, light)


def coffers(seed: int, light: str = "nominal") -> World:
    """Plasterboard with a field in the middle 0.15 to 0.2 m higher, lit by a strip round its edge; 180 degree lens."""
    rng = np.random.default_rng((seed, 13))
    room = Room(5.0, 4.6, 2.6)
    albedo = materials.plaster(rng, room)
    width, depth = rng.uniform(2.4, 3.0), rng.uniform(2.0, 2.6)
    x, y = rng.uniform(-0.3, 0.3) - width / 2, rng.uniform(-0.2, 0.2) - depth / 2
    field = _recess((x, y, x + width, y + depth), float(rng.uniform(0.15, 0.2)), 0.78, 0.8)
    field.top[:] *= paint.blotches(rng, field.top.shape[:2], 60.0, 0.02)
    middle = (width / 2 + rng.uniform(-0.2, 0.2), depth / 2 + rng.uniform(-0.2, 0.2))
    paint.disc(field.top, middle, 0.22, (0.25, 0.4, 0.5))
    spots = [Lamp(s * 2.2, t, 0.08) for s in (-1, 1) for t in (-1.9, -0.6, 0.7, 1.9) if rng.random() < 0.8]
    materials.detector(albedo, 0.5 + rng.uniform(0.0, 4.0), 0.35)
    materials.vent(albedo, rng.uniform(0.4, 4.0), 4.6 - 0.42, 0.3)
    interior = furnished(rng, room, ("door", "curtains", "picture", "plant", "shelf"))
    lit = replace(field, lamps=_light_strip(field.top.shape))
    return build(Design(albedo, spots, interior, recesses=(lit,), lens=Lens(fov_deg=180.0)), seed, light)


def office(seed: int, light: str = "nominal") -> World:
    """Metal panels with linear lamps, sprinklers, an air outlet, loudspeakers and a sign; the lens is off centre."""
    rng = np.random.default_rng((seed, 14))
    room = Room(6.6, 5.4, 2.8)
    albedo = materials.panels(rng, room, (0.3, 1.2))
    rows = [(x, y) for x in (-2.4, -0.9, 0.9, 2.4) for y in (-1.5, 1.2)]
    lamps = [Lamp(x + 0.3 * int(rng.integers(-1, 2)), y, 0.14, 1.1) for x, y in rows]
    chosen = [lamps[i] for i in sorted(rng.permutation(8)[:6])]
    for x in np.arange(0.75, room.width, 2.1):
        _sprinkler(albedo, x + rng.normal(0.0, 0.1), rng.uniform(1.9, 3.3))
    materials.vent(albedo, 0.3 * int(rng.integers(4, 16)), rng.uniform(0.4, 4.4), 0.58)
    for _ in range(2):
        paint.disc(albedo, (rng.uniform(0.6, 6.0), rng.uniform(0.6, 4.8)), 0.1, 0.4)
    left, top = rng.uniform(1.0, 5.0), rng.uniform(0.3, 4.8)
    paint.box(albedo, (left, top, left + 0.4, top + 0.06), (0.2, 0.55, 0.1))
    interior = furnished(rng, room, ("door", "window", "whiteboard", "cupboard", "radiator", "plant", "picture"))
    lens = Lens(radius=229.0, offset=(9.0, -6.0))
    return build(Design(albedo, chosen, interior, lens=lens), seed, light)


def attic(seed: int, light: str = "nominal") -> World:
    """Purlins under broad pale boards, round lamps between them."""
    rng = np.random.default_rng((seed, 16))
    room = Room(6.4, 4.8, 2.4)
    albedo = np.minimum(materials.boards(rng, room, float(rng.uniform(0.18, 0.24))) * 1.5, 0.8)
    centres = np.array([-2.0, 0.1, 2.1]) + rng.uniform(-0.2, 0.2, 3)
    wood = paint.wood(rng, paint.ceiling_shape(room), (0.16, 0.26, 0.36))
    drop = float(rng.uniform(0.14, 0.2))
    flank = wood.transpose(1, 0, 2)[: round(drop * CEILING_SCALE)]
    bars = tuple(BarDesign((float(c) - 0.07, float(c) + 0.07), drop, flank) for c in centres)
    gaps = (centres[1:] + centres[:-1]) / 2
    lamps = [Lamp(float(x), y + rng.normal(0.0, 0.2), 0.3) for x in gaps for y in (-1.3, 1.2)]
    interior = furnished(rng, room, ("door", "shelf", "window", "plant", "cupboard", "picture"))
    return build(Design(albedo, lamps, interior, (BarsDesign("y", bars, wood),)), seed, light)


def clinic(seed: int, light: str = "nominal") -> World:
    """Square metal panels, four large square lamps, two air outlets; 185 degree lens with a smaller circle."""
    rng = np.random.default_rng((seed, 17))
    room = Room(5.6, 5.6, 2.7)
    albedo = materials.panels(rng, room, (0.62, 0.62))
    lamps = [
        Lamp(x + rng.normal(0.0, 0.25), y + rng.normal(0.0, 0.25), 0.6, 0.6) for x in (-1.2, 1.3) for y in (-1.3, 1.1)
    ]
    for _ in range(2):
        materials.vent(albedo, rng.uniform(0.3, 4.7), rng.uniform(0.3, 4.7), 0.6)
    materials.detector(albedo, *rng.uniform(1.0, 4.6, 2))
    interior = furnished(rng, room, ("door", "curtains", "cupboard", "lockers", "radiator", "picture"))
    return build(Design(albedo, lamps, interior, lens=Lens(fov_deg=185.0, radius=225.0)), seed, light)


def gallery(seed: int, light: str = "nominal") -> World:
    """White plaster with a long skylight down the middle and two rows of spots along the walls."""
    rng = np.random.default_rng((seed, 18))
    room = Room(7.2, 5.0, 3.0)
    albedo = materials.plaster(rng, room)
    y = float(rng.uniform(-0.3, 0.3))
    skylight = _recess((-2.2, y - 0.45, 2.2, y + 0.45), 0.3, 0.1, 0.75)
    for x in (1.1, 2.2, 3.3):
        paint.box(skylight.top, (x - 0.02, 0.0, x + 0.02, 0.9), 0.35)
    spots = [Lamp(x + rng.normal(0.0, 0.15), side * 2.0, 0.1) for x in (-2.8, -1.4, 0.0, 1.4, 2.8) for side in (-1, 1)]
    materials.detector(albedo, rng.uniform(0.5, 2.0), 0.6)
    interior = furnished(rng, room, ("door", "picture", "picture", "plant", "whiteboard"))
    return build(Design(albedo, spots, interior, recesses=(replace(skylight, sky=1.1),)), seed, light)


def workshop(seed: int, light: str = "nominal") -> World:
    """High grey concrete with rows of long lamps, a crane's rail below it and two roof windows."""
    rng = np.random.default_rng((seed, 19))
    room = Room(8.0, 5.6, 3.6)
    albedo = materials.concrete(rng, room)
    rows = [(x, y) for x in (-2.9, -1.0, 1.0, 2.9) for y in (-1.8, 0.0, 1.8)]
    lamps = [Lamp(x + rng.normal(0.0, 0.1), y, 1.4, 0.12) for x, y in rows]
    chosen = [lamps[i] for i in sorted(rng.permutation(12)[:8])]
    rail = _metalwork(rng, room, "x", [(float(rng.uniform(-1.2, 1.2)), 0.24, 0.55, 0.3)])
    windows = [_recess((x, y, x + 0.8, y + 0.6), 0.25, 0.1, 0.6) for x, y in ((-2.0, -1.2), (1.3, 0.6))]
    interior = furnished(rng, room, ("door", "lockers", "cupboard", "radiator", "shelf", "whiteboard"))
    skylights = tuple(replace(window, sky=1.2) for window in windows)
    return build(Design(albedo, chosen, interior, (rail,), recesses=skylights), seed, light)


def parlour(seed: int, light: str = "nominal") -> World:
    """White plaster with a frame and a rosette of stucco, a chandelier in its middle and lamps towards the corners."""
    rng = np.random.default_rng((seed, 20))
    room = Room(5.4, 4.8, 2.9)
    albedo = materials.plaster(rng, room)
    for inset, value in ((0.42, 0.6), (0.46, 0.85), (0.54, 0.6), (0.56, 0.8)):
        paint.box(albedo, (inset, inset, room.width - inset, room.depth - inset), value)
    x, y = room.width / 2 + rng.uniform(-0.3, 0.3), room.depth / 2 + rng.uniform(-0.3, 0.3)
    for radius, value in ((0.75, 0.62), (0.7, 0.82), (0.5, 0.6), (0.46, 0.8)):
        paint.disc(albedo, (x, y), radius, value)
    corners = [
        Lamp(i * 1.6 + rng.normal(0.0, 0.1), j * 1.3 + rng.normal(0.0, 0.1), 0.16) for i in (-1, 1) for j in (-1, 1)
    ]
    lamps = [Lamp(x - room.width / 2, y - room.depth / 2, 0.42), *corners]
    interior = furnished(rng, room, ("door", "window", "curtains", "picture", "plant", "shelf"))
    return build(Design(albedo, lamps, interior), seed, light)


def library(seed: int, light: str = "nominal") -> World:
    """Dark beams close together under pale boards, globe lamps between them, shelves along most of the walls."""
    rng = np.random.default_rng((seed, 21))
    room = Room(7.4, 5.2, 3.1)
    albedo = np.minimum(materials.boards(rng, room, float(rng.uniform(0.14, 0.18))) * 2.0, 0.75)
    wood = paint.wood(rng, paint.ceiling_shape(room), (0.08, 0.12, 0.18))
    centres = np.arange(-3.0, 3.1, 1.2) + rng.normal(0.0, 0.05, 6)
    drop = float(rng.uniform(0.18, 0.24))
    flank = wood.transpose(1, 0, 2)[: round(drop * CEILING_SCALE)]
    bars = tuple(BarDesign((float(c) - 0.09, float(c) + 0.09), drop, flank) for c in centres)
    gaps = (centres[1:] + centres[:-1]) / 2
    lamps = [Lamp(float(x), y + rng.normal(0.0, 0.15), 0.34) for x in gaps[::2] for y in (-1.4, 1.5)]
    interior = furnished(rng, room, ("door", "shelf", "shelf", "shelf", "window", "picture"))
    return build(Design(albedo, lamps, interior, (BarsDesign("y", bars, wood),)), seed, light)


def hall(seed: int, light: str = "nominal") -> World:
    """12 x 12 m under a strictly periodic ceiling: identical tiles, and identical lamps every 1.8 m."""
    rng = np.random.default_rng((seed, 15))
    return build(
        periodic(rng, 1.8, ("door", "curtains", "lockers", "whiteboard", "radiator", "cupboard", "picture")),
        seed,
        light,
    )


def _recess(area: Area, depth: float, top: float, sides: float) -> RecessDesign:
    """A recess of even albedos."""
    width, length = area[2] - area[0], area[3] - area[1]
    shape = (round(length * CEILING_SCALE), round(width * CEILING_SCALE), 3)
    strip = (round(depth * WALL_SCALE), round(2 * (width + length) * WALL_SCALE), 3)
    return RecessDesign(area, depth, np.full(shape, top, np.float32), np.full(strip, sides, np.float32))


def _light_strip(shape: tuple[int, ...]) -> Light:
    """The light (H, W, 1) that a hidden strip of lamps throws on a recess's top: brightest along its edge."""
    from_edge = [np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n)) / CEILING_SCALE for n in shape[:2]]
    glow = sum(np.exp(-away / 0.12) for away in np.meshgrid(*from_edge, indexing="ij"))
    return np.asarray(1.1 * glow, np.float32)[:, :, None]


def _metalwork(
    rng: np.random.Generator, room: Room, along: str, bars: list[tuple[float, float, float, float]]
) -> BarsDesign:
    """Bars (centre, width, bottom, top) of sheet metal or paint, jointed every metre or so."""
    underside = paint.ceiling_canvas(room)
    length = room.depth if along == "y" else room.width
    half = (room.width if along == "y" else room.depth) / 2
    made = []
    for centre, width, bottom, top in bars:
        grey = np.array((1.0, 1.0, 0.98)) * rng.uniform(0.3, 0.6)
        flank = np.full((round((bottom - top) * CEILING_SCALE), round(length * CEILING_SCALE), 3), grey, np.float32)
        strip = underside if along == "y" else underside.transpose(1, 0, 2)
        columns = slice(
            round((centre - width / 2 + half) * CEILING_SCALE) - 1,
            round((centre + width / 2 + half) * CEILING_SCALE) + 1,
        )
        strip[:, columns] = grey
        for joint in np.arange(rng.uniform(0.2, 1.0), length, rng.uniform(0.9, 1.5)):
            at = slice(round(joint * CEILING_SCALE), round((joint + 0.03) * CEILING_SCALE))
            flank[:, at] *= 0.55
            strip[at, columns] *= 0.55
        made.append(BarDesign((centre - width / 2, centre + width / 2), bottom, flank, top))
    return BarsDesign("y" if along == "y" else "x", tuple(made), underside)


def _sprinkler(albedo: Light, x: float, y: float) -> None:
    paint.disc(albedo, (x, y), 0.045, 0.85)
    paint.disc(albedo, (x, y), 0.02, 0.15)
