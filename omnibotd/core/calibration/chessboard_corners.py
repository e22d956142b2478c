"""Crossings of a chessboard: places where two dark and two light sectors meet, whatever their size and slant."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.vision.frame import FloatImage, Image

Floats = NDArray[np.float64]

# The finest image searched has at most this many pixels along its longer side: finer squares than 8 px are no use.
_LONGEST_SIDE = 1600
# The coarsest has at least this many along its shorter side: a 3 x 3 board of squares of 8 px just fills a quarter.
_SHORTEST_SIDE = 100
# Crossings a level and in all: a board has 20-200; a carpet may have thousands, and neighbours cost their square.
_MOST_A_LEVEL, _MOST = 1500, 2000
# Around a crossing the grey values on this ring (px of the level) are looked at: as small as blur of one pixel allows.
_RADIUS, _SAMPLES = 4.5, 32
# Grey values by which the light sectors must be lighter than the dark ones: twice the noise of a poor webcam.
_LEAST_CONTRAST = 10.0
# Share of the ring's energy in even harmonics: a crossing looks the same turned by half, an edge or a blob's rim not.
_LEAST_SYMMETRY = 0.75
# Samples (of 32) in the narrowest sector: 22 degrees, squares seen at 80 degrees from their normal.
_NARROWEST = 2


@dataclass(frozen=True, slots=True)
class Crossings:
    """n crossings: `places` (n, 2) px; `directions` (n, 4) rad, of the edges that leave them, in rising order, the
    first from dark to light (as the angle, from u towards v, rises) and then in turns; `contrast` (n,) grey values."""

    places: Floats
    directions: Floats
    contrast: Floats

    def __len__(self) -> int:
        return len(self.places)


_NONE = Crossings(np.zeros((0, 2)), np.zeros((0, 4)), np.zeros(0))


def find_crossings(grey: Image) -> Crossings:
    """All crossings in a grey image (H, W), in it and its halves, each once; places to about half a pixel."""
    found = [(_NONE, 1.0), *(_on_level(level, scale) for level, scale in _levels(grey))]
    places = np.vstack([crossings.places for crossings, _ in found])
    directions = np.vstack([crossings.directions for crossings, _ in found])
    contrast = np.concatenate([crossings.contrast for crossings, _ in found])
    scales = np.concatenate([np.full(len(crossings), scale) for crossings, scale in found])
    kept = _each_once(places, contrast, scales)
    return Crossings(places[kept], directions[kept], contrast[kept])


def _levels(grey: Image) -> list[tuple[FloatImage, float]]:
    """The image smaller and smaller, with the factor that leads back to the original."""
    scale = max(1.0, max(grey.shape) / _LONGEST_SIDE)
    size = (max(round(grey.shape[1] / scale), 1), max(round(grey.shape[0] / scale), 1))
    level = grey if scale == 1.0 else cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    levels = []
    while min(level.shape) >= _SHORTEST_SIDE:
        levels.append((cv2.GaussianBlur(level, (0, 0), 1.0).astype(np.float32), scale))
        level = cv2.resize(level, (level.shape[1] // 2, level.shape[0] // 2), interpolation=cv2.INTER_AREA)
        scale *= 2.0
    return levels


def _on_level(smooth: FloatImage, scale: float) -> tuple[Crossings, float]:
    places = _saddles(smooth)
    ring = on_rings(smooth, places, _RADIUS)
    directions, contrast, good = _sectors(ring)
    in_original = (places[good] + 0.5) * scale - 0.5
    return Crossings(in_original, directions[good], contrast[good]), scale


def _saddles(smooth: FloatImage) -> Floats:
    """(n, 2) strongest local maxima of the negative Hessian determinant, the strongest first."""
    kernels = [(2, 0), (0, 2), (1, 1)]
    xx, yy, xy = (cv2.Sobel(smooth, cv2.CV_32F, dx, dy, ksize=5) for dx, dy in kernels)
    saddle = xy * xy - xx * yy
    peaks = (saddle == cv2.dilate(saddle, np.ones((5, 5), np.uint8))) & (saddle > 0.0)
    rim = math.ceil(_RADIUS) + 1
    peaks[:rim] = peaks[-rim:] = False
    peaks[:, :rim] = peaks[:, -rim:] = False
    v, u = np.nonzero(peaks)
    strongest = np.argsort(-saddle[v, u], kind="stable")[:_MOST_A_LEVEL]
    return np.column_stack([u, v])[strongest].astype(np.float64)


def on_rings(image: FloatImage, places: Floats, radius: float) -> Floats:
    """(n, 32) grey values on a ring around each place, the angle rising from u towards v."""
    angles = np.arange(_SAMPLES) * (2.0 * math.pi / _SAMPLES)
    u = places[:, :1] + radius * np.cos(angles)
    v = places[:, 1:] + radius * np.sin(angles)
    return sampled(image, u, v)


def sampled(image: FloatImage, u: Floats, v: Floats) -> Floats:
    """Grey values between pixels; the border's outside it. Any shape of at most 32766 x 32766 places."""
    if not u.size:
        return np.zeros(u.shape)
    maps = u.astype(np.float32), v.astype(np.float32)
    values = cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float64).reshape(u.shape)


def _sectors(ring: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Directions (n, 4) of the edges, contrast (n,), and which rings (n,) show two dark and two light sectors."""
    centred = ring - (ring.max(1, keepdims=True) + ring.min(1, keepdims=True)) / 2.0 if len(ring) else ring
    light = centred > 0.0
    turns = light != np.roll(light, -1, axis=1)
    contrast = np.ptp(ring, axis=1) if len(ring) else np.zeros(0)
    good = (turns.sum(1) == 4) & (contrast >= _LEAST_CONTRAST)
    directions = np.zeros((len(ring), 4))
    if good.any():
        index = np.nonzero(turns[good])[1].reshape(-1, 4)
        directions[good] = _crossing_angles(centred[good], index)
        widths = np.diff(np.column_stack([index, index[:, 0] + _SAMPLES]), axis=1)
        good[good] = (widths.min(1) >= _NARROWEST) & (_symmetry(ring[good]) >= _LEAST_SYMMETRY)
    return directions, contrast, good


def _crossing_angles(centred: Floats, index: NDArray[np.intp]) -> Floats:
    """(n, 4) angles at which the ring passes its middle grey after samples `index`, from dark to light first."""
    rows = np.arange(len(centred))[:, None]
    before, after = centred[rows, index], centred[rows, (index + 1) % _SAMPLES]
    angles = (index + before / (before - after)) * (2.0 * math.pi / _SAMPLES)
    falling_first = before[:, 0] > 0.0
    angles[falling_first] = np.roll(angles[falling_first], -1, axis=1)
    return angles


def _symmetry(ring: Floats) -> Floats:
    energy = np.abs(np.fft.rfft(ring, axis=1)[:, 1:]) ** 2  # harmonics 1, 2, 3 ...
    return np.asarray(energy[:, 1::2].sum(1) / np.maximum(energy.sum(1), 1e-9))


def _each_once(places: Floats, contrast: Floats, scales: Floats) -> NDArray[np.intp]:
    """Indices of crossings no better one is near; the finest level knows a place best, where it sees it in contrast."""
    order = np.lexsort((-contrast, scales))
    kept: list[int] = []
    for i in order:
        gaps = np.hypot(*(places[kept] - places[i]).T) if kept else np.zeros(0)
        if not (gaps < 2.5 * scales[i]).any():
            kept.append(int(i))
        if len(kept) == _MOST:
            break
    return np.array(kept, np.intp)
