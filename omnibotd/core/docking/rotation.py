"""How far one view is turned against another: several hypotheses from three cues, each blind where another sees.

A soft histogram of edge directions (thesis §7.2.1, equation 7.1), the brightness profile of the rim, where the walls
are, and the amplitude spectrum (Fourier-Mellin), which ignores shifts and can't tell half turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.features import gradients
from omnibotd.core.geometry import wrap
from omnibotd.core.vision.frame import FloatImage, Image

Spectrum = NDArray[np.complex128]
Floats = NDArray[np.float64]

_BINS = 360
_KEPT_PEAKS = 4
# Two peaks nearer than this (bins of 1 degree) are one.
_PEAK_WIDTH = 6
# The spectrum repeats after half a turn: its profile has 360 bins of half a degree.
_SPECTRUM_PEAKS = 2
_SPECTRUM_BIN = math.pi / _BINS
_SPECTRUM_SIZE = 128
_SPECTRUM_MARGIN = 4
# A histogram peak within 3 degrees of a spectral one adds nothing.
_SAME_ANGLE = 0.05


@dataclass(frozen=True, slots=True)
class RotationHypothesis:
    """The current view is turned by `yaw` against the target; `rim` in [-1, 1] is how well the rims agree there."""

    yaw: float
    rim: float


@dataclass(frozen=True)
class RotationSignature:
    """Fourier transforms, along the angle, of the three cues; `rim` is None for a lens that sees no wall."""

    edges: Spectrum
    rim: Spectrum | None
    spectrum: Spectrum

    @cached_property
    def edge_energy(self) -> tuple[float, float]:
        """Energy of the histogram over all directions and of its part that repeats after half a turn."""
        power = np.abs(self.edges[1:]) ** 2
        return float(power.sum()), float(power[1::2].sum())


class RotationCues:
    """Computes signatures of rectified views of `size` pixels a side."""

    def __init__(self, size: int) -> None:
        axis = np.arange(size) - (size - 1) / 2.0
        radius = np.hypot(*np.meshgrid(axis, axis)) / (size / 2.0)
        self._inside = np.clip((1.0 - radius) / 0.24, 0.0, 1.0).astype(np.float32)
        self._bell = np.cos(np.clip(radius, 0.0, 1.0) * (math.pi / 2.0)).astype(np.float32)
        inner = _SPECTRUM_SIZE - 2 * _SPECTRUM_MARGIN
        self._bell = np.asarray(cv2.resize(self._bell, (inner, inner), interpolation=cv2.INTER_AREA), np.float32)
        angle, ring = np.meshgrid(np.arange(_BINS) * _SPECTRUM_BIN, np.linspace(4.0, 56.0, 48))
        centre = _SPECTRUM_SIZE / 2.0
        self._polar_u = (centre + ring * np.cos(angle)).astype(np.float32)
        self._polar_v = (ring * np.sin(angle)).astype(np.float32)

    def signature(self, view: Image, feature: FloatImage, mask: Image, rim: Image | None) -> RotationSignature:
        """`view`, its `feature` and `mask` (255 where seen) are (size, size); `rim` (rings, 360) grey along circles."""
        rim_spectrum = None if rim is None else self._rim(rim)
        return RotationSignature(self._edges(view, mask), rim_spectrum, self._spectrum(feature))

    def _edges(self, view: Image, mask: Image) -> Spectrum:
        magnitude, angle = cv2.cartToPolar(*gradients(view, 1.2))
        weak, strong = np.percentile(magnitude[::3, ::3], (75, 98))
        weight = np.where((magnitude > weak) & (mask > 0), np.minimum(magnitude, strong) * self._inside, 0.0)
        bins = (angle * (_BINS / (2.0 * math.pi))).astype(np.int32).ravel() % _BINS
        histogram = np.fft.rfft(np.bincount(bins, weights=weight.ravel(), minlength=_BINS))
        order = np.arange(histogram.size)
        return np.asarray(histogram * np.exp(-0.5 * (order * math.radians(1.5)) ** 2), np.complex128)

    @staticmethod
    def _rim(rim: Image) -> Spectrum:
        profile = np.log(rim.astype(np.float32) + 8.0)
        profile = cv2.GaussianBlur(np.hstack([profile] * 3), (0, 0), 4.0)[:, _BINS : 2 * _BINS]
        return np.asarray(np.fft.rfft(profile - profile.mean(1, keepdims=True), axis=1), np.complex128)

    def _spectrum(self, feature: FloatImage) -> Spectrum:
        inner = cv2.resize(feature, self._bell.shape[::-1], interpolation=cv2.INTER_AREA)
        padded = np.zeros((_SPECTRUM_SIZE, _SPECTRUM_SIZE), np.float32)
        inside = slice(_SPECTRUM_MARGIN, _SPECTRUM_SIZE - _SPECTRUM_MARGIN)
        padded[inside, inside] = (inner - inner.mean()) * self._bell
        # Half of it, the other being its mirror image: all columns, and the rows from the centre down.
        amplitude = np.log1p(np.abs(np.fft.fftshift(np.fft.rfft2(padded, axes=(1, 0)), axes=1))).astype(np.float32)
        polar = cv2.remap(amplitude, self._polar_u, self._polar_v, cv2.INTER_LINEAR)
        return np.asarray(np.fft.rfft(polar - polar.mean(1, keepdims=True), axis=1), np.complex128)


def rotation_hypotheses(target: RotationSignature, current: RotationSignature) -> list[RotationHypothesis]:
    """At most 8 angles worth trying, no two within 3 degrees unless of one cue."""
    rim = _rim_agreement(target, current)
    angles = _spectral_angles(target, current)
    for angle in _peaks(_edge_agreement(target, current) + 0.5 * rim):
        if all(abs(wrap(angle - other)) > _SAME_ANGLE for other in angles):
            angles.append(angle)
    return [RotationHypothesis(angle, float(rim[round(math.degrees(angle)) % _BINS])) for angle in angles]


def _edge_agreement(target: RotationSignature, current: RotationSignature) -> Floats:
    """(360,) in [-1, 1]: half of it ignores the sign of contrast (half turns), which changes with the light."""
    cross = target.edges * np.conj(current.edges)
    cross[0] = 0.0
    unsigned = cross.copy()
    unsigned[1::2] = 0.0
    (whole_t, even_t), (whole_c, even_c) = target.edge_energy, current.edge_energy
    whole = np.fft.irfft(cross, _BINS) / (math.sqrt(whole_t * whole_c) + 1e-9)
    even = np.fft.irfft(unsigned, _BINS) / (math.sqrt(even_t * even_c) + 1e-9)
    return np.asarray((whole + even) * (0.5 * _BINS / 2), np.float64)


def _rim_agreement(target: RotationSignature, current: RotationSignature) -> Floats:
    if target.rim is None or current.rim is None:
        return np.zeros(_BINS)
    energy = float((np.abs(target.rim) ** 2).sum() * (np.abs(current.rim) ** 2).sum())
    cross = (target.rim * np.conj(current.rim)).sum(0)
    return np.asarray(np.fft.irfft(cross, _BINS) * (_BINS / 2) / (math.sqrt(energy) + 1e-9), np.float64)


def _spectral_angles(target: RotationSignature, current: RotationSignature) -> list[float]:
    """Fourier-Mellin: the best turns of the amplitude spectrum, each with its twin half a turn away."""
    cross = (target.spectrum * np.conj(current.spectrum)).sum(0)
    profile = np.fft.irfft(cross / (np.sqrt(np.abs(cross)) + 1e-9), _BINS)
    angles = []
    for _ in range(_SPECTRUM_PEAKS):
        peak = int(np.argmax(profile))
        angle = (peak + _parabola(profile, peak)) * _SPECTRUM_BIN
        angles += [wrap(angle), wrap(angle + math.pi)]
        profile[np.arange(peak - 8, peak + 9) % _BINS] = -np.inf
    return angles


def _peaks(profile: Floats) -> list[float]:
    """Angles (rad) of the highest local maxima of a profile of one-degree bins."""
    maxima = np.flatnonzero((profile >= np.roll(profile, 1)) & (profile > np.roll(profile, -1)))
    kept: list[int] = []
    for peak in maxima[np.argsort(-profile[maxima])]:
        if all(abs((peak - other + 180) % _BINS - 180) > _PEAK_WIDTH for other in kept):
            kept.append(int(peak))
        if len(kept) == _KEPT_PEAKS:
            break
    return [wrap(math.radians(peak + _parabola(profile, peak))) for peak in kept]


def _parabola(profile: Floats, peak: int) -> float:
    """Offset of the top from bin `peak`, in [-0.5, 0.5] bins; 0 next to a neighbour already struck out."""
    left, middle, right = profile[peak - 1], profile[peak], profile[(peak + 1) % len(profile)]
    if not (math.isfinite(left) and math.isfinite(right)):
        return 0.0
    return float(np.clip(0.5 * (left - right) / (left - 2.0 * middle + right - 1e-12), -0.5, 0.5))
