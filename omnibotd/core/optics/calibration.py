"""Where camera and mirror really are, from landmarks whose places are known (thesis, section 4.6).

Eleven numbers say how a sensor differs from its drawing: the camera's turn (3) and shift (3) in the mirror's frame, the
mirror's tilt (2) and shift (3) in the frame of the landmarks; a cone turned about its axis is the same cone. What the
landmarks leave open is held by how well such things are put together, so that the covariance is that of the estimate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from omnibotd.core.errors import CoreError
from omnibotd.core.optics.rigid import Floats, Rigid
from omnibotd.core.optics.sensor import ConeSensor, Sights
from omnibotd.core.optics.stereo import Fixes, StereoPair, triangulate

PARAMETERS = 11
# How far off its drawing something put together by hand is, standard deviation: rad, m.
_TURN, _SHIFT = np.radians(6.0), 0.006
_PRIOR = np.array([_TURN] * 3 + [_SHIFT] * 3 + [_TURN] * 2 + [_SHIFT] * 3)
_STEP, _PIXEL_STEP = 1e-6, 1e-3  # for differences: rad or m, and px; the curvature over these is harmless
_ENDLESS = 1e3  # m, radius
_ROUNDS = 60  # Levenberg-Marquardt; ten are usual
_SETTLED = 1e-2  # standard deviations that a step must be worth: below lies the projection's own rounding
_DAMPING, _EASE, _TIGHTEN, _STUCK = 1e-3, 0.2, 8.0, 1e9
# Landmarks nearer to the tip's picture (px) do not count: there the projection bends sharply and ends.
_NEAR_TIP = 8.0


class OpticsError(CoreError):
    """Landmarks that calibrate nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A sensor as it is. `covariance` (11, 11): rad and m, in the order of this module's text.

    `misfit`: root mean square of what is left, in standard deviations of a pixel; far above 1 the landmarks or the lens
    are wrong.
    """

    sensor: ConeSensor
    covariance: Floats
    misfit: float


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedPair:
    """Two calibrated sensors in the frame of the landmarks."""

    upper: Calibrated
    lower: Calibrated

    @property
    def pair(self) -> StereoPair:
        return StereoPair(self.upper.sensor, self.lower.sensor)

    def locate(self, upper: Floats, lower: Floats, sigma: float) -> tuple[Fixes, Floats]:
        """Points at pixels (n, 2) known to `sigma` px, and their covariances (n, 3, 3): of the pixels and of the
        calibration, which is the same for all points."""
        pixels, sides = (upper, lower), (self.upper, self.lower)
        sights = [side.sensor.sights(seen) for side, seen in zip(sides, pixels, strict=True)]
        fixes = triangulate(*sights)
        spread = np.zeros((len(upper), 3, 3))
        for i, (side, seen) in enumerate(zip(sides, pixels, strict=True)):
            for change, weight in _changes(side, seen, sigma):
                other = (change, sights[1]) if i == 0 else (sights[0], change)
                moved = (triangulate(*other).points - fixes.points) * weight
                spread += moved[:, :, None] * moved[:, None, :]
        return fixes, spread


def calibrate_pair(
    drawing: StereoPair, landmarks: Floats, upper: Floats, lower: Floats, sigma: float
) -> CalibratedPair:
    """Both sensors of a pair from landmarks (n, 3) at pixels (n, 2); NaN where one does not see a landmark."""
    return CalibratedPair(
        calibrate(drawing.upper, landmarks, upper, sigma), calibrate(drawing.lower, landmarks, lower, sigma)
    )


def calibrate(drawing: ConeSensor, landmarks: Floats, pixels: Floats, sigma: float) -> Calibrated:
    """The sensor whose pictures of `landmarks` (n, 3) fit `pixels` (n, 2), known to `sigma` px, best.

    A row of NaN is a landmark that was not seen. OpticsError with fewer than six, or none that the drawing can see.
    """
    if landmarks.shape != (len(pixels), 3) or pixels.shape[1:] != (2,):
        raise OpticsError(f"landmarks {landmarks.shape} with pixels {pixels.shape}: (n, 3) and (n, 2) are needed")
    seen = np.isfinite(pixels).all(axis=1) & np.isfinite(landmarks).all(axis=1)
    if seen.sum() * 2 <= PARAMETERS:
        raise OpticsError(f"{seen.sum()} landmarks seen: {PARAMETERS} numbers need six or more, all round the sensor")
    return _Problem(drawing, landmarks[seen], pixels[seen], sigma).solved()


def displaced(sensor: ConeSensor, numbers: Floats) -> ConeSensor:
    """The sensor put together so wrongly (11,)."""
    camera, mirror = sensor.cone_from_camera, sensor.frame_from_cone
    turned = Rigid.of(numbers[:3])
    tilt = Rigid.of((numbers[6], numbers[7], 0.0))
    return replace(
        sensor,
        cone_from_camera=Rigid(turned.rotation @ camera.rotation, camera.translation + numbers[3:6]),
        frame_from_cone=Rigid(mirror.rotation @ tilt.rotation, mirror.translation + numbers[8:]),
    )


class _Problem:
    """Least squares by Levenberg and Marquardt, over the eleven numbers."""

    def __init__(self, drawing: ConeSensor, landmarks: Floats, pixels: Floats, sigma: float) -> None:
        # Without a rim no landmark drops out of the fit on the way.
        self._drawing = replace(drawing, cone=replace(drawing.cone, radius=_ENDLESS))
        self._mirror = drawing.cone
        self._landmarks, self._pixels, self._sigma = landmarks, pixels, sigma

    def solved(self) -> Calibrated:
        """First with all landmarks, to see where the tip is, then without those near it."""
        rough, _ = self._fitted(np.zeros(PARAMETERS))
        tip = displaced(self._drawing, rough).tip()
        clear = np.hypot(*(self._pixels - tip).T) > _NEAR_TIP
        if clear.sum() * 2 <= PARAMETERS:
            raise OpticsError(f"{clear.sum()} landmarks seen clear of the tip: six or more are needed")
        self._landmarks, self._pixels = self._landmarks[clear], self._pixels[clear]
        numbers, settled = self._fitted(rough)
        if not settled:
            raise OpticsError(f"no end after {_ROUNDS} rounds: are these the landmarks, and is this the drawing?")
        return self._verdict(numbers)

    def _fitted(self, numbers: Floats) -> tuple[Floats, bool]:
        """Better numbers, and whether nothing can be bettered."""
        damping = _DAMPING
        for _ in range(_ROUNDS):
            shown = self._shown(numbers)
            slopes = self._slopes(numbers, shown)
            information = slopes.T @ slopes + np.diag(_PRIOR**-2)
            pull = slopes.T @ self._misfits(shown) + numbers / _PRIOR**2
            if pull @ np.linalg.solve(information, pull) < _SETTLED**2:
                return numbers, True
            step = -np.linalg.solve(information + damping * np.diag(np.diag(information)), pull)
            if self._cost(numbers + step) < self._cost(numbers):
                numbers, damping = numbers + step, damping * _EASE
            else:  # no better, or no cost at all: a camera turned away from its mirror
                damping *= _TIGHTEN
            if damping > _STUCK:
                break
        return numbers, False

    def _verdict(self, numbers: Floats) -> Calibrated:
        shown = self._shown(numbers)
        slopes = self._slopes(numbers, shown)
        covariance = np.asarray(np.linalg.inv(slopes.T @ slopes + np.diag(_PRIOR**-2)), np.float64)
        misfit = float(np.sqrt(np.mean(self._misfits(shown) ** 2)))
        return Calibrated(replace(displaced(self._drawing, numbers), cone=self._mirror), covariance, misfit)

    def _shown(self, numbers: Floats) -> Floats:
        """Where the landmarks would appear (n, 2): what rises out of sight is taken to stay at the tip."""
        sensor = displaced(self._drawing, numbers)
        shown = sensor.pixels(self._landmarks)
        return np.where(np.isnan(shown), sensor.tip(), shown)

    def _misfits(self, shown: Floats) -> Floats:
        """Pixels off (2 n,), in standard deviations."""
        return np.asarray((shown - self._pixels).ravel() / self._sigma, np.float64)

    def _cost(self, numbers: Floats) -> float:
        return float((self._misfits(self._shown(numbers)) ** 2).sum() + (numbers**2 / _PRIOR**2).sum())

    def _slopes(self, numbers: Floats, shown: Floats) -> Floats:
        """Derivatives (2 n, 11) of the misfits, from the closed form of the way back: what keeps the line of sight on
        the landmark. None for landmarks out of sight."""
        sensor = displaced(self._drawing, numbers)
        across = _across(sensor.sights(shown).direction)

        def passing(sensor: ConeSensor, pixels: Floats) -> Floats:
            sights = sensor.sights(pixels)
            off = np.cross(sights.direction, self._landmarks - sights.origin)
            return np.asarray(np.einsum("nij,nj->ni", across, off), np.float64)

        of_pixels = _difference(lambda change: passing(sensor, shown + change), 2, _PIXEL_STEP)
        of_numbers = _difference(
            lambda change: passing(displaced(self._drawing, numbers + change), shown), PARAMETERS, _STEP
        )
        seen = np.isfinite(of_pixels).all(axis=(1, 2)) & np.isfinite(of_numbers).all(axis=(1, 2))
        slopes = np.zeros((len(shown), 2, PARAMETERS))
        slopes[seen] = -np.linalg.solve(of_pixels[seen], of_numbers[seen])
        return slopes.reshape(-1, PARAMETERS) / self._sigma


def _across(directions: Floats) -> Floats:
    """Two unit vectors (n, 2, 3) across each direction (n, 3)."""
    aside = np.eye(3)[np.argmin(np.abs(np.nan_to_num(directions)), axis=1)]
    first = np.cross(directions, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=1)


def _difference(function: Callable[[Floats], Floats], count: int, step: float) -> Floats:
    """Central differences of a function of `count` numbers, as the last axis."""
    return np.stack([function(e) - function(-e) for e in step * np.eye(count)], axis=-1) / (2.0 * step)


def _changes(side: Calibrated, pixels: Floats, sigma: float) -> list[tuple[Sights, float]]:
    """The sights after small independent changes, and how much larger than those one standard deviation is."""
    axes = np.linalg.cholesky(side.covariance).T
    sizes = np.abs(axes).max(axis=1)
    of_pixels = [side.sensor.sights(pixels + _PIXEL_STEP * axis) for axis in np.eye(2)]
    of_sensor = [
        displaced(side.sensor, axis * (_STEP / size)).sights(pixels) for axis, size in zip(axes, sizes, strict=True)
    ]
    weights = [sigma / _PIXEL_STEP] * 2 + [float(size) / _STEP for size in sizes]
    return list(zip(of_pixels + of_sensor, weights, strict=True))
