"""Comparing views: a rotation-invariant spectrum to look up, circular correlation to verify and to find the heading."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.view import RINGS, SECTORS, View, Viewer

BINS = 12  # harmonics kept a ring; beyond them a view 10 cm away has lost its phase anyway
FEATURES = RINGS * BINS

Floats = NDArray[np.float32]
Harmonics = NDArray[np.complex64]

# Outer rings cover more sky: weight about their area, but never let the rim rule alone.
RING_WEIGHTS = np.sqrt(np.linspace(0.5, 1.5, RINGS)).astype(np.float32)[:, None]
_ORDERS = np.arange(SECTORS // 2 + 1)
_SLOPES = (-1j * _ORDERS).astype(np.complex64)  # of e^(-1j * order * yaw), relative
# Each harmonic of a real signal stands for two, but for the constant one and the highest.
_MULTIPLICITY = np.where((_ORDERS == 0) | (_ORDERS == SECTORS // 2), 1.0, 2.0).astype(np.float32)


class Descriptor:
    """From frames of one camera to views (16, 64) and spectra (192,)."""

    def __init__(self, camera: CameraModel) -> None:
        self._viewer = Viewer(camera)
        self.seen = self._viewer.seen

    def view(self, frame: Frame) -> View:
        """(RINGS, SECTORS) float32, zero mean, unit variance; sector k looks at bearing k * 2 pi / SECTORS, CCW."""
        return self.normalised(self.texture(frame))

    def texture(self, frame: Frame) -> View:
        """What a view is before it is normalised."""
        return self._viewer.texture(frame)

    def normalised(self, texture: View) -> View:
        """The view of a texture."""
        return self._viewer.normalised(texture)

    def view_and_contrast(self, frame: Frame) -> tuple[View, float]:
        """The view, and the spread of the relative gradient before it was normalised."""
        texture = self.texture(frame)
        return self.normalised(texture), self._viewer.contrast(texture)

    @staticmethod
    def spectrum(view: View) -> Floats:
        """(..., FEATURES): amplitudes of the first harmonics of every ring of (..., RINGS, SECTORS); blind to turns."""
        amplitude = np.abs(np.fft.rfft(view, axis=-1)[..., :BINS]) / math.sqrt(SECTORS)
        amplitude[..., 0] /= math.sqrt(2.0)
        weighted = amplitude * RING_WEIGHTS
        return np.asarray(weighted.reshape(*view.shape[:-2], FEATURES), np.float32)


def harmonics(views: View) -> Harmonics:
    """Views (..., RINGS, SECTORS) ring-weighted, zero-mean, unit-norm, as (..., RINGS, SECTORS/2+1) to correlate."""
    weighted = views * RING_WEIGHTS
    weighted = weighted - weighted.mean((-1, -2), keepdims=True)
    spectra = np.fft.rfft(weighted, axis=-1).astype(np.complex64)
    power = ((spectra.real**2 + spectra.imag**2) @ _MULTIPLICITY).sum(-1)
    return np.asarray(spectra / np.maximum(np.sqrt(power), 1e-9)[..., None, None], np.complex64)


def correlate(query: Harmonics, stored: Harmonics) -> tuple[Floats, Floats]:
    """Compare one view (RINGS, K) with M others (M, RINGS, K): turn (M,) rad and normalised correlation (M,).

    `turn` is the heading of the query minus that of the stored view, at the correlation's peak (a parabola's).
    """
    curve = np.fft.irfft(np.einsum("mrk,rk->mk", stored, query.conj()), n=SECTORS, axis=-1)
    return _peaks(np.asarray(curve * SECTORS, np.float32))


def correlate_views(query: Harmonics, stored: View, norms: Floats) -> tuple[Floats, Floats]:
    """What `correlate` gives, from M views (M, RINGS, SECTORS) as they are and their `weighted_norms` (M,).

    One matrix product with all turns of the query takes a third of the time of M transforms.
    """
    weighted = np.fft.irfft(query, n=SECTORS, axis=-1).astype(np.float32) * (RING_WEIGHTS * math.sqrt(SECTORS))
    windows = sliding_window_view(np.tile(weighted, 2), SECTORS, axis=1)  # (RINGS, start, SECTORS)
    turns = windows[:, SECTORS:0:-1].swapaxes(0, 1).reshape(SECTORS, -1)
    return _peaks(stored.reshape(len(stored), -1) @ turns.T / norms[:, None])


def weighted_norms(views: View) -> Floats:
    """(M,) norms of views (M, RINGS, SECTORS), ring-weighted and zero-mean."""
    weighted = (views * RING_WEIGHTS).reshape(len(views), -1)
    return np.asarray(np.maximum(weighted.std(1) * math.sqrt(weighted.shape[1]), 1e-9), np.float32)


def _peaks(curve: Floats) -> tuple[Floats, Floats]:
    """Turn (M,) rad and height (M,) at the peaks of correlations (M, SECTORS) by turn."""
    rows = np.arange(len(curve))
    peak = curve.argmax(-1)
    centre, before, after = curve[rows, peak], curve[rows, peak - 1], curve[rows, (peak + 1) % SECTORS]
    shift = 0.5 * (before - after) / (before - 2.0 * centre + after - 1e-12)
    turn = (peak + shift) * (2.0 * math.pi / SECTORS)
    wrapped = np.where(turn > math.pi, turn - 2.0 * math.pi, turn)
    return wrapped.astype(np.float32), (centre - 0.25 * (before - after) * shift).astype(np.float32)


def smoothed(view: View, orders: int) -> View:
    """View (RINGS, SECTORS) without the harmonics from order `orders` on."""
    spectrum = np.fft.rfft(view, axis=-1)
    spectrum[..., orders:] = 0.0
    return np.asarray(np.fft.irfft(spectrum, n=SECTORS, axis=-1), np.float32)


def turned(views: View, yaw: NDArray[np.floating]) -> View:
    """Views (..., RINGS, SECTORS) of a base with headings `yaw` (...), turned from its axes into the map's."""
    phase = np.exp(-1j * _ORDERS * np.asarray(yaw)[..., None])[..., None, :]
    return np.asarray(np.fft.irfft(np.fft.rfft(views, axis=-1) * phase, n=SECTORS, axis=-1), np.float32)


def turned_with_slope(view: View, yaw: float) -> tuple[View, View]:
    """One view (RINGS, SECTORS) turned by `yaw`, and how that changes per radian."""
    spectrum = np.fft.rfft(view, axis=-1) * np.exp(-1j * yaw * _ORDERS)
    both = np.fft.irfft(np.stack([spectrum, spectrum * _SLOPES]), n=SECTORS, axis=-1).astype(np.float32)
    return both[0], both[1]
