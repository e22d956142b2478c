"""Textures of a room packed into one picture, so that a frame is one `cv2.remap`.

A plane at a fixed height is seen under a scale that depends on the pixel alone, so each pixel has its own
level of a pyramid, found once. Texel i of a texture with p texels a metre covers [i / p, (i + 1) / p].
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]

LEVELS = 7  # of a pyramid, half an octave apart: down to 1/8, what the ceiling needs 70 degrees off the zenith
_MARGIN = 2  # texels repeated around each texture: bilinear sampling reads one beyond the edge


@dataclass(frozen=True, slots=True)
class Patch:
    """Where a texture lies in the atlas: pixel = scale * metres + offset."""

    scale: float
    column: float
    row: float


class Atlas:
    """Stacks textures below each other, then hands out the picture."""

    def __init__(self) -> None:
        self._rows: list[Image] = []
        self._height = 0

    def add(self, texture: Image, scale: float) -> Patch:
        """Stores a texture (H, W, 3) of `scale` texels a metre whose first texel's corner is (0, 0)."""
        padded = np.pad(texture, ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0)), "edge")
        patch = Patch(scale, _MARGIN - 0.5, self._height + _MARGIN - 0.5)
        self._rows.append(padded)
        self._height += padded.shape[0]
        return patch

    def add_pyramid(self, texture: Image, scale: float) -> list[Patch]:
        """The texture at full size and ever smaller, half an octave apart."""
        patches = []
        for level in range(LEVELS):
            side = [max(4, round(n * 2.0 ** (-level / 2))) for n in texture.shape[1::-1]]
            small = cv2.resize(texture, side, interpolation=cv2.INTER_AREA)
            patches.append(self.add(np.asarray(small, np.uint8), scale * side[0] / texture.shape[1]))
        return patches

    def picture(self) -> Image:
        """Everything added, in one image (H, W, 3); unused parts are black."""
        out = np.zeros((self._height, max(row.shape[1] for row in self._rows), 3), np.uint8)
        top = 0
        for row in self._rows:
            out[top : top + row.shape[0], : row.shape[1]] = row
            top += row.shape[0]
        return out


class PlaneMap:
    """Atlas coordinates of the points where the pixels' rays pierce a horizontal plane above the camera."""

    def __init__(self, reach: Floats, bearing: Floats, seen_scale: Floats, patches: list[Patch]) -> None:
        """`reach` metres across the floor to the hit; `seen_scale` px a metre there; all (n,)."""
        wanted = 2.0 * np.log2(patches[0].scale / np.maximum(seen_scale, 1e-3))
        level = np.clip(np.rint(wanted), 0, len(patches) - 1).astype(int)
        scale, column, row = (
            np.array([getattr(p, name) for p in patches], np.float32)[level] for name in ("scale", "column", "row")
        )
        along, left = scale * reach * np.cos(bearing), scale * reach * np.sin(bearing)
        self._basis = np.stack([along, left, scale, column, row]).astype(np.float32)

    def coordinates(self, x: float, y: float, cos: float, sin: float) -> Floats:
        """(2, n) atlas columns and rows; camera (x, y) m from the texture's corner, heading (cos, sin)."""
        move = np.array([[cos, -sin, x, 1.0, 0.0], [sin, cos, y, 0.0, 1.0]], np.float32)
        # Not `@`: BLAS would wake a thread per core for a quarter of a millisecond's work, and spin in the rest.
        return np.asarray(np.einsum("ij,jn->in", move, self._basis), np.float32)
