"""Rooms to drive in, one factory each: FACTORY(seed) -> World. The seed changes the details.

`light` is one of "nominal", "lamps_off", "half_lamps", "sun".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tools.sim import paint
from tools.sim.paint import Lamp, Light
from tools.sim.panorama import load_panorama
from tools.sim.world import CEILING_SCALE, SIDE, Beams, Surfaces, World

TILE = 0.6  # m, the grid of suspended ceilings
_T_BAR = 0.024
_HALF = SIDE / 2


@dataclass(frozen=True)
class _Design:
    """What a ceiling reflects, its lamps, and its beams: their spans in x, how far they hang down (m)."""

    albedo: Light
    lamps: Sequence[Lamp]
    spans: tuple[tuple[float, float], ...] = ()
    drop: float = 0.0


def tiles(seed: int, light: str = "nominal") -> World:
    """A suspended ceiling of mineral tiles in a grid of T-bars, with lamp panels, vents and stained tiles."""
    rng = np.random.default_rng((seed, 1))
    albedo = paint.ceiling_canvas()
    _lay_tiles(rng, albedo)
    cells = round(SIDE / TILE)
    slots = [(c, r) for c in range(1, cells - 1, 3) for r in range(1, cells - 1, 3)]
    chosen = [slots[i] for i in sorted(rng.choice(len(slots), 5, replace=False))]
    lamps = [Lamp(*_tile_centre(c + int(rng.integers(2)), r + int(rng.integers(2))), 0.52, 0.52) for c, r in chosen]
    for _ in range(3):
        _vent(albedo, int(rng.integers(cells)), int(rng.integers(cells)))
    return _room(rng, _Design(albedo, lamps), seed, light)


def plain(seed: int, light: str = "nominal") -> World:
    """White plaster with a faint texture, two round lamps and a smoke detector: little to go by."""
    rng = np.random.default_rng((seed, 2))
    albedo = _plaster(rng)
    lamps = [Lamp(s * rng.uniform(0.8, 1.8), rng.uniform(-1.6, 1.6), rng.uniform(0.3, 0.45)) for s in (-1, 1)]
    x, y = rng.uniform(1.5, SIDE - 1.5, 2)
    paint.disc(albedo, (x, y), 0.07, 0.35)
    paint.disc(albedo, (x, y), 0.055, 0.85)
    return _room(rng, _Design(albedo, lamps), seed, light)


def beams(seed: int, light: str = "nominal") -> World:
    """Wooden beams 0.2 to 0.25 m below white plaster: parallax, and flanks seen from the side."""
    rng = np.random.default_rng((seed, 3))
    centres = np.array([-2.1, -0.75, 0.75, 2.1]) + rng.uniform(-0.15, 0.15, 4)
    width, drop = rng.uniform(0.16, 0.22), rng.uniform(0.2, 0.25)
    spans = tuple((float(c - width / 2), float(c + width / 2)) for c in centres)
    albedo = _plaster(rng)
    for low, high in spans:  # corners get less light
        paint.box(albedo, (low + _HALF - 0.05, 0, high + _HALF + 0.05, SIDE), 0.5, CEILING_SCALE)
    gaps = (centres[1:] + centres[:-1]) / 2
    lamps = [Lamp(float(g), float(y + rng.uniform(-0.4, 0.4)), 0.24, 0.9) for g in gaps for y in (-1.5, 1.5)]
    chosen = [lamps[i] for i in rng.permutation(6)[:4]]
    return _room(rng, _Design(albedo, chosen, spans, float(drop)), seed, light)


def photo(seed: int, light: str = "nominal") -> World:
    """A room whose surfaces are a photograph of a real one; the seed picks the photograph and turns it."""
    if light != "nominal":
        raise ValueError(f"a photograph has the light it was taken in: light is {light!r}, expected 'nominal'")
    ceiling, walls = load_panorama(seed)
    return World(Surfaces(ceiling, walls), seed)


def _tile_centre(column: int, row: int) -> tuple[float, float]:
    return (column + 0.5) * TILE - _HALF, (row + 0.5) * TILE - _HALF


def _lay_tiles(rng: np.random.Generator, albedo: Light) -> None:
    """Speckled tiles of slightly different tone, a few with water stains, between metal bars. In place."""
    n, step = albedo.shape[0], round(TILE * CEILING_SCALE)
    speckle = (rng.random((n, n, 1)) < 0.03).astype(np.float32)
    albedo *= 1.0 - 0.35 * speckle
    albedo *= paint.blotches(rng, (n, n), 4.0, 0.015)
    for row in range(0, n, step):
        for column in range(0, n, step):
            albedo[row : row + step, column : column + step] *= rng.normal(1.0, 0.025)
    for _ in range(5):
        _stain(rng, albedo)
    bar = round(_T_BAR * CEILING_SCALE / 2)
    for edge in range(0, n + 1, step):
        lines = slice(max(0, edge - bar), edge + bar)
        albedo[lines] = 0.42
        albedo[:, lines] = 0.42


def _stain(rng: np.random.Generator, albedo: Light) -> None:
    """A brownish ring with a frayed edge, where water dried. In place."""
    n = albedo.shape[0]
    x, y = rng.uniform(0.5, SIDE - 0.5, 2)
    at = (np.arange(n, dtype=np.float32) + 0.5) / CEILING_SCALE
    away = np.hypot(at[None, :] - x, (at[:, None] - y) * rng.uniform(0.7, 1.4))
    frayed = away * paint.blotches(rng, (n, n), 8.0, 0.06)[:, :, 0] / rng.uniform(0.12, 0.28)
    depth = np.exp(-(((frayed - 0.85) / 0.18) ** 2)) + 0.4 * (frayed < 0.85)
    albedo *= 1.0 - 0.45 * depth[:, :, None] * np.array([1.0, 0.75, 0.5], np.float32)


def _vent(albedo: Light, column: int, row: int) -> None:
    """An air outlet in a tile: concentric slots. In place."""
    left, top = column * TILE, row * TILE
    for i, margin in enumerate(np.arange(0.05, 0.28, 0.028)):
        slot = (left + margin, top + margin, left + TILE - margin, top + TILE - margin)
        paint.box(albedo, slot, 0.12 if i % 2 else 0.6, CEILING_SCALE)


def _plaster(rng: np.random.Generator) -> Light:
    """White plaster: faint marks of the trowel and a few hairline cracks."""
    albedo = paint.ceiling_canvas((0.76, 0.79, 0.80))
    n = albedo.shape[0]
    for size, contrast in ((90.0, 0.02), (14.0, 0.012), (3.0, 0.015)):
        albedo *= paint.blotches(rng, (n, n), size, contrast)
    return albedo


def _room(rng: np.random.Generator, design: _Design, seed: int, light: str) -> World:
    """Lights the ceiling, hangs the beams, furnishes the walls and develops it all."""
    lamps = paint.switched(design.lamps, light)
    exposure = paint.exposure_of(lamps, light)
    lit = paint.illumination(lamps, light, design.albedo.shape[0], CEILING_SCALE)
    ceiling = design.albedo * lit
    paint.add_lamps(ceiling, lamps)
    walls = paint.develop(paint.walls(rng, light, lamps), exposure)
    hung = _hang(rng, design, lit, exposure) if design.spans else None
    return World(Surfaces(paint.develop(paint.glare(ceiling, CEILING_SCALE), exposure), walls, hung), seed)


def _hang(rng: np.random.Generator, design: _Design, lit: Light, exposure: float) -> Beams:
    """Beams of grained wood, the flanks lighter than the undersides."""
    n = lit.shape[0]
    wood = np.full((n, n, 3), (0.10, 0.18, 0.27), np.float32)
    grain = paint.blotches(rng, (n // 10, n), 3.0, 0.18).repeat(10, axis=0)
    wood *= np.clip(grain, 0.4, 1.8) * paint.blotches(rng, (n, n), 30.0, 0.15)
    rows = round(design.drop * CEILING_SCALE)
    shade = np.linspace(1.5, 0.8, rows, dtype=np.float32)[:, None, None]
    flank = wood.transpose(1, 0, 2)[:rows] * lit.mean() * shade
    underside = wood * lit * 0.8
    return Beams(design.spans, design.drop, paint.develop(underside, exposure), paint.develop(flank, exposure))
