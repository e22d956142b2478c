"""Optic flow from pairs of edge pixels (thesis, section 4.2.1, algorithm 4.1)."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.contrast import slopes
from omnibotd.core.compass.round_view import Ring, RoundView
from omnibotd.core.compass.turn import BACK, FRONT, NO_TURN, SECTOR, Turn
from omnibotd.core.vision.frame import FloatImage

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Grey levels a pixel above which a pixel is an edge (tau_1); pairs within a 5 x 5 window, at more than 40 degrees.
_EDGE = 5.0
_WINDOW = 2
_CROSSING = math.sin(math.radians(40.0))
# [assumed] A brightness edge must reach as far as the motion, or its slope says nothing about it.
_BLUR = 1.0
# Each unordered pair once: the half of the window that comes later in the picture.
_LATER = [(0, c) for c in range(1, _WINDOW + 1)] + [
    (r, c) for r in range(1, _WINDOW + 1) for c in range(-_WINDOW, _WINDOW + 1)
]


class TwoPointFlow:
    """Algorithm 4.1. Good to about two pixels of motion; needs edges in two directions near each other."""

    def turn(self, before: RoundView, now: RoundView) -> Turn:
        first, second = (_smooth(view) for view in (before, now))
        du, dv = slopes(first)
        edges = _sectors(before.ring, first.shape) & (cv2.magnitude(du, dv) > _EDGE)
        turns = np.concatenate([_pair_turns(edges, du, dv, second - first, before.ring, *to) for to in _LATER])
        if len(turns) == 0:
            return NO_TURN
        # What turns with the robot stands still: the picture turns the other way.
        return Turn(float(-before.ring.sense * turns.mean()), len(turns))


def _smooth(view: RoundView) -> FloatImage:
    return np.asarray(cv2.GaussianBlur(view.grey.astype(np.float32), (0, 0), _BLUR), np.float32)


def _pair_turns(
    edges: Mask, du: FloatImage, dv: FloatImage, change: FloatImage, ring: Ring, rows: int, columns: int
) -> Floats:
    """Angles (n,) by which pairs of edge pixels (rows, columns) apart turn about the ring's centre (Eq 4.3-4.6)."""
    row, column = np.nonzero(edges[: len(edges) - rows])
    inside = (column + columns >= 0) & (column + columns < edges.shape[1])
    row, column = row[inside], column[inside]
    pair = edges[row + rows, column + columns]
    here = row[pair], column[pair]
    there = here[0] + rows, here[1] + columns
    (ux, uy, along_u), (wx, wy, along_w) = (_normal_flow(du[at], dv[at], change[at]) for at in (here, there))
    cross = ux * wy - uy * wx
    sharp = np.abs(cross) > _CROSSING  # of the lesser angle between the two lines: opposite gradients are no pair
    cross = np.where(sharp, cross, 1.0)
    vx = (along_u * wy - along_w * uy) / cross
    vy = (along_w * ux - along_u * wx) / cross
    x, y = here[1] + columns / 2.0 - ring.u, here[0] + rows / 2.0 - ring.v
    turned = np.arctan2(x * (y + vy) - y * (x + vx), x * (x + vx) + y * (y + vy))
    return np.asarray(turned[sharp], np.float64)


def _normal_flow(du: FloatImage, dv: FloatImage, change: FloatImage) -> tuple[Floats, Floats, Floats]:
    """Unit gradient, and the flow along it in pixels (Eq 4.3)."""
    size = np.hypot(du, dv).astype(np.float64)
    return du / size, dv / size, -change / size


@lru_cache(maxsize=4)
def _sectors(ring: Ring, shape: tuple[int, int]) -> Mask:
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float64)
    radius, bearing = np.hypot(u - ring.u, v - ring.v), ring.bearings(u, v)
    near = [np.cos(bearing - middle) >= math.cos(SECTOR / 2.0) for middle in (FRONT, BACK)]
    return np.asarray((near[0] | near[1]) & (radius >= ring.inner) & (radius <= ring.outer))
