"""Rooms to tune on and to try things in, one factory each: FACTORY(seed) -> World. The seed changes the details.

`light` is one of (a photograph has only the light it was taken in):

- "nominal": all ceiling lamps, and daylight in the windows;
- "half_lamps": every second lamp off;
- "lamps_off": daylight from the windows alone, so the ceiling is bright near them and dim elsewhere;
- "sun": as nominal, with sunlit windows, the sun thrown onto a part of the ceiling, and a patch of sun that creeps
  along the walls; exposure shorter, so the rest is darker;
- "night": no daylight and no ceiling lamp: a standing lamp in a corner and the open door to a lit corridor. The
  camera's gain is at its limit: the picture stays dark, its noise is two and a half times as strong.

Rooms to report on, never tuned on: reporting.py, and here all seeds from 100.
"""

from __future__ import annotations

import numpy as np

from tools.sim import materials, paint
from tools.sim.building import BarDesign, BarsDesign, Design, build
from tools.sim.interior import furnished
from tools.sim.lighting import Lamp
from tools.sim.materials import TILE
from tools.sim.panorama import load_panorama
from tools.sim.room import CEILING_SCALE, Room, Surfaces
from tools.sim.world import World

_ROOM = Room(6.0, 6.0, 2.7)
_HALF = _ROOM.width / 2


def tiles(seed: int, light: str = "nominal") -> World:
    """A suspended ceiling of mineral tiles in a grid of T-bars, with lamp panels, vents and stained tiles."""
    rng = np.random.default_rng((seed, 1))
    albedo = materials.tiled(rng, _ROOM)
    cells = round(_ROOM.width / TILE)
    slots = [(c, r) for c in range(1, cells - 1, 3) for r in range(1, cells - 1, 3)]
    chosen = [slots[i] for i in sorted(rng.choice(len(slots), 5, replace=False))]
    lamps = [Lamp(*_tile_centre(c + int(rng.integers(2)), r + int(rng.integers(2))), 0.52, 0.52) for c, r in chosen]
    for _ in range(3):
        materials.vent(albedo, int(rng.integers(cells)) * TILE, int(rng.integers(cells)) * TILE)
    return build(Design(albedo, lamps, furnished(rng, _ROOM)), seed, light)


def plain(seed: int, light: str = "nominal") -> World:
    """White plaster with a faint texture, two round lamps and a smoke detector: little to go by."""
    rng = np.random.default_rng((seed, 2))
    albedo = materials.plaster(rng, _ROOM)
    lamps = [Lamp(s * rng.uniform(0.8, 1.8), rng.uniform(-1.6, 1.6), rng.uniform(0.3, 0.45)) for s in (-1, 1)]
    materials.detector(albedo, *rng.uniform(1.5, _ROOM.width - 1.5, 2))
    return build(Design(albedo, lamps, furnished(rng, _ROOM)), seed, light)


def beams(seed: int, light: str = "nominal") -> World:
    """Wooden beams 0.2 to 0.25 m below white plaster: parallax, and flanks seen from the side."""
    rng = np.random.default_rng((seed, 3))
    centres = np.array([-2.1, -0.75, 0.75, 2.1]) + rng.uniform(-0.15, 0.15, 4)
    width, drop = rng.uniform(0.16, 0.22), float(rng.uniform(0.2, 0.25))
    albedo = materials.plaster(rng, _ROOM)
    for centre in centres:  # corners get less light
        left, right = centre - width / 2 + _HALF - 0.05, centre + width / 2 + _HALF + 0.05
        paint.box(albedo, (left, 0, right, _ROOM.depth), 0.5)
    gaps = (centres[1:] + centres[:-1]) / 2
    lamps = [Lamp(float(g), float(y + rng.uniform(-0.4, 0.4)), 0.24, 0.9) for g in gaps for y in (-1.5, 1.5)]
    chosen = [lamps[i] for i in rng.permutation(6)[:4]]
    interior = furnished(rng, _ROOM)
    wood = paint.wood(rng, paint.ceiling_shape(_ROOM), (0.10, 0.18, 0.27))
    flank = wood.transpose(1, 0, 2)[: round(drop * CEILING_SCALE)]
    bars = tuple(BarDesign((float(c - width / 2), float(c + width / 2)), drop, flank) for c in centres)
    return build(Design(albedo, chosen, interior, (BarsDesign("y", bars, wood),)), seed, light)


def photo(seed: int, light: str = "nominal") -> World:
    """A room whose surfaces are a photograph of a real one; the seed picks the photograph and turns it."""
    if light != "nominal":
        raise ValueError(f"a photograph has the light it was taken in: light is {light!r}, expected 'nominal'")
    return World(Surfaces(*load_panorama(seed, _ROOM)), seed, room=_ROOM)


def hall(seed: int, light: str = "nominal") -> World:
    """12 x 12 m under a strictly periodic ceiling: tiles and lamps all alike, a lamp every 1.5 to 2 m.

    Only the walls at the picture's rim tell one cell from the next.
    """
    rng = np.random.default_rng((seed, 5))
    pitch = round(float(rng.uniform(1.5, 2.0)), 2)
    return build(periodic(rng, pitch, ("door", "window", "shelf", "picture", "cupboard", "plant")), seed, light)


def periodic(rng: np.random.Generator, pitch: float, kinds: tuple[str, ...]) -> Design:
    """A hall of 12 x 12 x 3 m whose lattice of lamps lies anywhere with respect to its walls.

    Lamps beyond the walls are there for their light only: it too must be periodic.
    """
    room = Room(12.0, 12.0, 3.0)
    start = tuple(round(float(at), 2) for at in rng.uniform(0.0, pitch, 2))
    steps = range(-round(8.0 / pitch) - 1, round(8.0 / pitch) + 1)
    x, y = start[0] + pitch / 2, start[1] + pitch / 2
    lamps = [Lamp(x + i * pitch, y + j * pitch, 0.55) for i in steps for j in steps]
    return Design(materials.repeated(rng, room, pitch, (start[0], start[1])), lamps, furnished(rng, room, kinds))


def _tile_centre(column: int, row: int) -> tuple[float, float]:
    return (column + 0.5) * TILE - _HALF, (row + 0.5) * TILE - _HALF
