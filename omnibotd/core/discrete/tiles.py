"""The perception: bearings of four blue tiles on the floor, always in the same order (thesis §6.4.2).

The camera faces the floor, its image's top towards the robot's front; its right is then the robot's right.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.thesis.compass import BLUE, blobs
from omnibotd.core.vision.frame import Image

Floats = NDArray[np.float64]

TILES = 4
# px, [assumed]: noise makes smaller blobs; a tile of 0.3 m seen from 1.2 m up across the whole arena makes 50.
MIN_AREA = 12
# px that a tile may move from one picture to the next, [assumed]: a quarter of an action's turn moves it by 40, and
# from the arena's corner two tiles are never less than 120 apart.
GATE = 60.0


def bearings(tiles: Floats, centre: tuple[float, float]) -> Floats:
    """(n,) directions of tiles (n, 2) px, counter-clockwise from the robot's front (Eqs 6.6 and 6.7)."""
    # The printed arctan of the quotient would not tell ahead from behind.
    return np.arctan2(centre[0] - tiles[:, 0], centre[1] - tiles[:, 1])


class TileTracker:
    """Keeps the names A, B, C, D on the tiles from picture to picture.

    It never renames: where tiles are hidden or have jumped there is no perception, until they are seen where they were.
    """

    def __init__(self, centre: tuple[float, float]) -> None:
        """`centre`: where the optical axis meets the picture, px (u, v)."""
        self._centre = centre
        self._tiles: Floats | None = None

    def begin(self, image: Image) -> Floats | None:
        """As `see`, and names the tiles anew: A is the first one left of straight ahead, then counter-clockwise."""
        seen = _blue_tiles(image)
        if seen is None:
            return None
        self._tiles = seen[np.argsort(bearings(seen, self._centre) % math.tau)]
        return bearings(self._tiles, self._centre)

    def see(self, image: Image) -> Floats | None:
        """The perception (4,) rad of a picture (BGR); None where not all four tiles are recognised."""
        seen = _blue_tiles(image)
        if self._tiles is None or seen is None:
            return None
        apart = np.linalg.norm(self._tiles[:, None] - seen, axis=-1)
        nearest = apart.argmin(1)
        if apart.min(1).max() > GATE or len(set(nearest.tolist())) < TILES:
            return None
        self._tiles = seen[nearest]
        return bearings(self._tiles, self._centre)


def _blue_tiles(image: Image) -> Floats | None:
    """(4, 2) mean pixels of the four largest blue areas; None where there are fewer."""
    centres, areas = blobs(image, BLUE, MIN_AREA)
    if len(areas) < TILES:
        return None
    return centres[np.argsort(-areas, kind="stable")[:TILES]]
