"""From a design in albedos to a World: the light is put on, everything is developed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tools.sim.interior import Interior
from tools.sim.lens import Lens
from tools.sim.lighting import WARM, Lamp, Lighting, lit_ceiling
from tools.sim.paint import Light, develop, glare
from tools.sim.room import CEILING_SCALE, Bar, Bars, Recess, Sunlight, Surfaces
from tools.sim.world import World


@dataclass(frozen=True)
class BarDesign:
    """A bar that fills `span` across and hangs `top` to `bottom` m below the ceiling; what its sides reflect."""

    span: tuple[float, float]
    bottom: float
    flank: Light
    top: float = 0.0


@dataclass(frozen=True)
class BarsDesign:
    """Bars in one direction; `underside` is an albedo of the ceiling's size."""

    along: Literal["x", "y"]
    bars: tuple[BarDesign, ...]
    underside: Light


@dataclass(frozen=True)
class RecessDesign:
    """A higher rectangle (x0, y0, x1, y1) of the ceiling: albedos, and the light its own lamps or the sky give it."""

    area: tuple[float, float, float, float]
    depth: float
    top: Light
    sides: Light
    lamps: Light | float = 0.0  # on the top
    sky: float = 0.0


@dataclass(frozen=True)
class Design:
    """A room before it is lit: what its ceiling reflects, its lamps, its walls, what hangs."""

    albedo: Light
    lamps: Sequence[Lamp]
    interior: Interior
    bars: tuple[BarsDesign, ...] = ()
    recesses: tuple[RecessDesign, ...] = ()
    lens: Lens | None = None


def build(design: Design, seed: int, light: str) -> World:
    """The room in that light; raises ValueError if there is none of that name."""
    interior = design.interior
    lighting = Lighting(light, design.lamps, interior.room, interior.openings)
    exposure, lit = lighting.exposure, lighting.on_ceiling()
    surfaces = Surfaces(
        develop(glare(lit_ceiling(design.albedo, lit, lighting), CEILING_SCALE), exposure),
        develop(interior.lit(lighting), exposure),
        tuple(_hang(bars, lit, exposure) for bars in design.bars),
        tuple(_recess(recess, lighting, lit) for recess in design.recesses),
        _sunlight(interior, lighting) if light == "sun" else None,
    )
    return World(surfaces, seed, design.lens, interior.room, lighting.noise)


def _sunlight(interior: Interior, lighting: Lighting) -> Sunlight:
    """A patch on the lower part of the walls, first on the east wall."""
    room = interior.room
    walls = develop(interior.lit(lighting) + 1.3 * interior.strip, lighting.exposure)
    return Sunlight(walls, room.width + 0.2 * room.depth, room.height - 1.7, room.height - 0.5)


def _hang(design: BarsDesign, lit: Light, exposure: float) -> Bars:
    """Bars in that light, the flanks lighter than the undersides, and most so at the bottom edge."""
    bars = []
    for bar in design.bars:
        shade = np.linspace(1.5, 0.8, bar.flank.shape[0], dtype=np.float32)[:, None, None]
        flank = develop(bar.flank * lit.mean() * shade, exposure)
        bars.append(Bar(bar.span, bar.bottom, flank, bar.top))
    return Bars(design.along, tuple(bars), develop(design.underside * lit * 0.8, exposure))


def _recess(design: RecessDesign, lighting: Lighting, lit: Light) -> Recess:
    """A recess gets the ceiling's light less what its sides keep off, and what its own lamps or the sky add."""
    room = lighting.room
    rows, columns = design.top.shape[:2]
    row = round((design.area[1] + room.depth / 2) * CEILING_SCALE)
    column = round((design.area[0] + room.width / 2) * CEILING_SCALE)
    received = 0.8 * lit[row : row + rows, column : column + columns]
    own = lighting.burning * np.asarray(design.lamps, np.float32)
    top = design.top * (received + 0.12 * float(np.mean(own))) + own * np.array(WARM, np.float32)
    top += design.sky * lighting.panes * np.array((1.0, 0.92, 0.85), np.float32)
    beside = float(received.mean()) + 0.5 * float(np.mean(own)) + 0.4 * design.sky * lighting.panes
    shade = np.linspace(1.2, 0.8, design.sides.shape[0], dtype=np.float32)[:, None, None]
    exposure = lighting.exposure
    sides = develop(design.sides * shade * beside * np.array(WARM, np.float32), exposure)
    return Recess(design.area, design.depth, develop(glare(top, CEILING_SCALE), exposure), sides)
