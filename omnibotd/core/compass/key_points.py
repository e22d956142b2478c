"""The points of a key view: where contrast changes, a few in every cell of the picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.contrast import Contrast, slopes
from omnibotd.core.vision.frame import FloatImage

Indices = NDArray[np.intp]
AnyFloats = NDArray[np.floating]

# Side of a cell (rad), and the share of its pixels that may be points: what is rich must not outvote all the rest.
_CELL, _SHARE = 1.0 / 6.0, 1.0 / 9.0
# Change of contrast a pixel below which a point says nothing over the noise.
_FAINT = 0.5
# Zenith angles looked at (rad): lower down is mostly what moves, and the robot itself. At the zenith bearings end.
_HIGHEST, _LOWEST = math.radians(2.0), math.radians(80.0)


@dataclass(frozen=True, slots=True, eq=False)
class KeyPoints:
    """N points, sorted by cell; all in single precision.

    Unit rays (x, y, z) in the base frame; `value`, the contrast there; how it changes when the ray is moved by a unit
    of x (`along_x`), of y (`along_y`), or turned about the vertical by a radian (`along_turn`); `cell` (N,) counts the
    cells that have points, `first` (C,) is where each begins, `names` (C,) says where in the picture each lies.
    """

    x: FloatImage
    y: FloatImage
    z: FloatImage
    value: FloatImage
    along_x: FloatImage
    along_y: FloatImage
    along_turn: FloatImage
    cell: Indices
    first: Indices
    names: Indices

    @classmethod
    def of(cls, picture: FloatImage, contrast: Contrast) -> KeyPoints:
        """The points of a picture that `contrast` made."""
        du, dv = slopes(picture)
        row, column = np.divmod(_chosen(np.hypot(du, dv), contrast), contrast.size)
        u, v = (column - contrast.centre).astype(np.float32), (row - contrast.centre).astype(np.float32)
        names = cell_names(u, v, contrast)
        first = np.flatnonzero(np.diff(names, prepend=-1))
        radius = np.hypot(u, v)
        zenith, cos, sin = radius / np.float32(contrast.focal), u / radius, v / radius
        du, dv = du[row, column], dv[row, column]
        # Unit rays: a step outwards of dh turns them by cos(zenith) dh, one across by dh / sin(zenith).
        outwards = contrast.focal * np.cos(zenith) * (du * cos + dv * sin)
        across = radius / np.sin(zenith) * (dv * cos - du * sin)
        return cls(
            _single(np.sin(zenith) * cos),
            _single(np.sin(zenith) * sin),
            _single(np.cos(zenith)),
            _single(picture[row, column]),
            _single(outwards * cos - across * sin),
            _single(outwards * sin + across * cos),
            _single(dv * u - du * v),
            np.repeat(np.arange(len(first)), np.diff(first, append=len(names))),
            first,
            names[first],
        )

    def __len__(self) -> int:
        return len(self.x)


def _single(values: AnyFloats) -> FloatImage:
    return np.asarray(values, np.float32)


def cell_names(u: AnyFloats, v: AnyFloats, contrast: Contrast) -> Indices:
    """Of the cells that hold points (px from the zenith); none is negative."""
    side = _side(contrast)
    return np.asarray((np.floor(v / side) + 500) * 1000 + np.floor(u / side) + 500, np.intp)


def _side(contrast: Contrast) -> int:
    return max(3, round(_CELL * contrast.focal))


def _chosen(strength: FloatImage, contrast: Contrast) -> Indices:
    """Indices into the flat picture of the strongest points of each cell, sorted by cell."""
    v, u = np.mgrid[0 : contrast.size, 0 : contrast.size].astype(np.float32) - np.float32(contrast.centre)
    zenith = np.hypot(u, v) / contrast.focal
    seen = (contrast.seen > 0) & (zenith > _HIGHEST) & (zenith < _LOWEST)
    good = np.flatnonzero(seen & (strength > _FAINT))
    names = cell_names(u.ravel()[good], v.ravel()[good], contrast)
    order = np.lexsort((-strength.ravel()[good], names))
    good, names = good[order], names[order]
    first = np.flatnonzero(np.diff(names, prepend=-1))
    rank = np.arange(len(names)) - np.repeat(first, np.diff(first, append=len(names)))
    return np.asarray(good[rank < max(3, _SHARE * _side(contrast) ** 2)], np.intp)
