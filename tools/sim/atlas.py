"""Textures of a room packed into one picture, so that a frame is one `cv2.remap`.

A plane at a fixed height is seen under a scale that depends on the zenith angle alone, so each ray has its own
level of a pyramid, found once. Texel i of a texture with p texels a metre covers [i / p, (i + 1) / p].
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tools.sim.lens import Image

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
        """Everything added, in one image (H, W, 4): OpenCV samples four channels faster than three."""
        out = np.zeros((self._height, max(row.shape[1] for row in self._rows), 4), np.uint8)
        top = 0
        for row in self._rows:
            out[top : top + row.shape[0], : row.shape[1], :3] = row
            top += row.shape[0]
        return out
