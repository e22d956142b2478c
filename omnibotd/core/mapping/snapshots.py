"""Snapshots: views stored at nodes, each ring as its low harmonics in ten bytes.

What localisation needs of a view is coarse: harmonics above the twentieth hold a tenth of its power and have lost their
phase 8 cm away, and regression averages over many nodes. So all coefficients share one step, larger than most of them,
and higher orders, being smaller, get fewer bits (reverse water-filling).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import MapError
from omnibotd.core.vision.view import RINGS, SECTORS, View

# Bits of each order's coefficients, from the ring's mean (order 0) on: twice their spread fits in.
_ORDER_BITS = (4,) + 5 * (3,) + 8 * (2,) + 7 * (1,)
ORDERS = len(_ORDER_BITS)
# Of coefficients sum(cell * e^(-2 pi i k s / SECTORS)) / sqrt(SECTORS), cells having unit variance.
STEP = 0.8

# No level stands for 0.0. A ring that the camera does not see is all zero bytes instead: as levels, that would be every
# part at its lowest, which no view has.

# A real and an imaginary part of every order, but for the mean, which is real.
_BITS = np.array(_ORDER_BITS[:1] + tuple(bits for bits in _ORDER_BITS[1:] for _ in range(2)))
_PARTS = len(_BITS)
_PART_OF_BIT = np.repeat(np.arange(_PARTS), _BITS)
_SHIFT_OF_BIT = np.concatenate([np.arange(bits)[::-1] for bits in _BITS])  # most significant first
_RING_BYTES = len(_PART_OF_BIT) // 8
BYTES = RINGS * _RING_BYTES


def _patterns() -> NDArray[np.float32]:
    """(parts, SECTORS): what each part at 1 adds to the cells of its ring."""
    spectra = np.zeros((_PARTS, ORDERS), complex)
    order = (np.arange(_PARTS) + 1) // 2
    imaginary = (np.arange(_PARTS) > 0) & (np.arange(_PARTS) % 2 == 0)
    spectra[np.arange(_PARTS), order] = np.where(imaginary, 1j, 1.0)
    return np.asarray(np.fft.irfft(spectra, n=SECTORS, axis=-1) * np.sqrt(SECTORS), np.float32)


# A part is (level + 0.5) * STEP, and a level the sum of its bits less half its range: a ring is its bits times these
# patterns (bits, SECTORS), plus a constant one (SECTORS,).
_BIT_PATTERNS = (STEP * 2.0 ** _SHIFT_OF_BIT[:, None] * _patterns()[_PART_OF_BIT]).astype(np.float32)
_OFFSET_PATTERN = (STEP * (0.5 - 2.0 ** (_BITS - 1)) @ _patterns()).astype(np.float32)


def pack(views: View) -> NDArray[np.uint8]:
    """(N, RINGS, SECTORS) views to (N, BYTES), ring by ring."""
    if views.ndim != 3 or views.shape[1:] != (RINGS, SECTORS):
        raise MapError(f"views of shape {views.shape}, expected (N, {RINGS}, {SECTORS})")
    spectra = np.fft.rfft(views, axis=-1)[..., :ORDERS] / np.sqrt(SECTORS)
    parts = np.stack([spectra.real, spectra.imag], -1).reshape(len(views), RINGS, 2 * ORDERS)
    parts = np.delete(parts, 1, axis=-1)  # the mean's imaginary part
    middle = 2 ** (_BITS - 1)
    levels = np.clip(np.floor(parts / STEP), -middle, middle - 1).astype(np.int8) + middle
    bits = (levels[..., _PART_OF_BIT] >> _SHIFT_OF_BIT) & 1
    rings = np.packbits(bits.astype(np.uint8), axis=-1)
    rings[~views.any(-1)] = 0
    return rings.reshape(len(views), BYTES)


def unpack(snapshots: NDArray[np.uint8]) -> View:
    """(N, BYTES) snapshots to (N, RINGS, SECTORS) views that correlate at 0.87 with those packed."""
    if snapshots.ndim != 2 or snapshots.shape[1] != BYTES:
        raise MapError(f"snapshots of shape {snapshots.shape}, expected (N, {BYTES}): the map is from another version")
    rings = snapshots.reshape(-1, _RING_BYTES)
    cells = np.unpackbits(rings, axis=-1).astype(np.float32) @ _BIT_PATTERNS + _OFFSET_PATTERN
    cells[~rings.any(-1)] = 0.0
    return np.asarray(cells, np.float32).reshape(-1, RINGS, SECTORS)
