"""What a simulated room is made of: its box, the textures on its surfaces, what hangs from the ceiling.

Lengths in metres. A texture's first texel is at the corner (xmin, ymin); columns run along x, rows along y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tools.sim.lens import Image

CAMERA = 0.5  # above the floor
CEILING_SCALE = 100.0  # texels a metre; the camera sees 66 px a metre straight above
WALL_SCALE = 64.0
WALL_FOOT = 0.3  # of floor below the wall's strip: rays below the horizon end there


@dataclass(frozen=True, slots=True)
class Room:
    """A box centred on the origin: `width` along x, `depth` along y."""

    width: float = 6.0
    depth: float = 6.0
    height: float = 2.7

    @property
    def rise(self) -> float:
        """From the camera to the ceiling."""
        return self.height - CAMERA

    @property
    def perimeter(self) -> float:
        return 2.0 * (self.width + self.depth)

    @property
    def walls(self) -> tuple[tuple[float, float], ...]:
        """(start, length) along the strip of the south, east, north and west wall."""
        w, d = self.width, self.depth
        return ((0.0, w), (w, d), (w + d, w), (2 * w + d, d))


@dataclass(frozen=True)
class Bar:
    """Something straight from wall to wall below the ceiling: a beam, a duct, a pipe, a cable tray.

    It fills `span` across, and hangs from `top` to `bottom` below the ceiling. `flank` (rows from the bottom upwards,
    columns along the bar) is what both its sides look like.
    """

    span: tuple[float, float]
    bottom: float
    flank: Image
    top: float = 0.0


@dataclass(frozen=True)
class Bars:
    """Bars in one direction, with spans that do not overlap: those along y span x and the other way round.

    `underside` is a texture of the whole ceiling's size, seen where there are bars.
    """

    along: Literal["x", "y"]
    bars: tuple[Bar, ...]
    underside: Image


@dataclass(frozen=True)
class Recess:
    """A rectangle (x0, y0, x1, y1) of the ceiling that lies `depth` higher: a coffer, the shaft of a skylight.

    `sides`: the strip round its edge, as the walls of a room, downwards from its top.
    """

    area: tuple[float, float, float, float]
    depth: float
    top: Image
    sides: Image


@dataclass(frozen=True)
class Sunlight:
    """A patch of sun on the walls, from `top` to `bottom` below the ceiling, that creeps along them.

    `walls`: the strip of walls as if the sun shone on all of it; `start`: where along it the patch is at t = 0.
    """

    walls: Image
    start: float
    top: float
    bottom: float


@dataclass(frozen=True)
class Surfaces:
    """Textures (H, W, 3) of the ceiling, the walls, and what hangs.

    The walls are one strip, counter-clockwise from the corner (xmin, ymin), downwards from the ceiling.
    """

    ceiling: Image
    walls: Image
    bars: tuple[Bars, ...] = ()
    recesses: tuple[Recess, ...] = ()
    sunlight: Sunlight | None = None
