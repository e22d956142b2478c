"""A fisheye lens (Kannala-Brandt, OpenCV's `fisheye`) from views of a chessboard.

In order: views that repeat another are set aside; lenses of many kinds and widths are tried for a start (`lens_start`);
the best of them are adjusted with the boards' poses (`lens_fit`); corners and views that don't fit are dropped and the
rest adjusted again; the uncertainty that is left, and where corners were seen, decide the verdict (`lens_verdict`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration import lens_start
from omnibotd.core.calibration.chessboard import BoardView
from omnibotd.core.calibration.lens_fit import TOLERANCE, Fit, Observations, adjust, cost
from omnibotd.core.calibration.lens_verdict import FEWEST_VIEWS, Circle, evidence_of, judge, too_few
from omnibotd.core.percept import Verdict

Floats = NDArray[np.float64]

# A view of fewer corners says less than the six numbers of its pose take away.
_FEWEST_CORNERS = 8
# Lenses are tried on so many views: more cost time and tell no more.
_TRIED_ON = 12
# Starts that are adjusted; the best is nearly always the first.
_STARTS = 3
# Where, in shares of the smaller side from the picture's middle, the axis is looked for if no circle shows it.
_OFF_CENTRE = (0.0, -0.12, 0.12)
# Tolerance of the first adjustments, in shares of the picture's longer side: 2 px of 640.
_COARSE = 0.003
# Corners are dropped that lie so many standard deviations off.
_OUTLIER = 5.0
# A view is dropped that lies so many times farther off than most do, and a view or a corner only if it is at least
# this far off (share of the longer side): 0.8 px of 640.
_BAD_VIEW, _BAD = 3.0, 0.0012
# Dropping one may show the next; views that still contradict each other after this are for the verdict.
_ROUNDS = 4
_NO_LENS = (
    "No lens fits these corners: use pictures of one camera at one size, neither cut nor corrected, and a flat board"
)
# Views whose corners all lie within this (share of the longer side) of each other are one: 2 px of 640.
_SAME = 0.003


@dataclass(frozen=True, slots=True)
class LensResult:
    """A lens and how far it can be trusted; px unless said otherwise.

    `rms` is the root of the mean squared distance of corner and model (OpenCV's convention); of one coordinate it is
    rms / sqrt(2). `view_rms` has (name, rms) of every view used, `dropped` (name, why) of the others. `covered` (rad)
    is the largest zenith angle of a corner, `coverage` [0, 1] the share of the picture in which corners lay,
    `edge_sigma` the standard deviation of projection at 80 degrees, or the picture's edge where that is nearer.
    `fov` (rad) is the angle across the image circle, or the picture where no circle shows, as far as it is known.
    `verdict` is ACCEPTED or REJECTED; `sentence` says why, and what to do.
    """

    width: int
    height: int
    camera_matrix: tuple[float, float, float, float]  # fx, fy, cx, cy
    distortion: tuple[float, float, float, float]
    rms: float
    view_rms: tuple[tuple[str, float], ...]
    dropped: tuple[tuple[str, str], ...]
    covered: float
    coverage: float
    edge_sigma: float
    fov: float
    verdict: Verdict
    sentence: str

    def camera_info(self) -> Mapping[str, Any]:
        """In the layout of ROS camera_info, readable by `CameraModel.from_camera_info`, and the figures above."""
        fx, fy, cx, cy = (round(value, 4) for value in self.camera_matrix)
        return {
            "image_width": self.width,
            "image_height": self.height,
            "camera_name": "ceiling",
            "camera_matrix": {"rows": 3, "cols": 3, "data": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]},
            "distortion_model": "equidistant",
            "distortion_coefficients": {"rows": 1, "cols": 4, "data": [round(k, 8) for k in self.distortion]},
            "rectification_matrix": {"rows": 3, "cols": 3, "data": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]},
            "projection_matrix": {
                "rows": 3,
                "cols": 4,
                "data": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
            },
            "rms_px": round(self.rms, 4),
            "edge_sigma_px": round(self.edge_sigma, 3),
            "covered_deg": round(math.degrees(self.covered), 1),
            "coverage": round(self.coverage, 3),
            "field_of_view_deg": round(math.degrees(self.fov), 1),
            "views": {name: round(rms, 3) for name, rms in self.view_rms},
            "dropped": dict(self.dropped),
        }


def calibrate_lens(
    views: Sequence[BoardView],
    size: tuple[int, int],
    circle: Circle | None = None,
) -> LensResult:
    """The lens that took `views` in pictures of `size` (width, height).

    `circle` (cx, cy, radius px) is the image circle; None where none shows, being larger than the picture.
    Never raises for bad views: the verdict is then REJECTED, and the lens may be anything.
    """
    distinct, dropped = _distinct(views, max(size))
    if len(distinct) < FEWEST_VIEWS:
        return _refused(too_few(len(distinct), len(dropped)), dropped, size)
    bundle = _Bundle.of(distinct)
    fit = _first_fit(bundle.seen, size, circle)
    if fit is None:
        return _refused(_NO_LENS, dropped, size)
    bundle, fit = _without_outliers(bundle, fit, max(size), dropped)
    return _result(fit, bundle, dropped, len(distinct) - len(bundle.names), size, circle)


@dataclass(frozen=True, slots=True)
class _Bundle:
    """The views that a fit is made of."""

    names: tuple[str, ...]
    seen: Observations

    def only(self, views: NDArray[np.intp]) -> _Bundle:
        """Of these views, by index."""
        return _Bundle(tuple(self.names[i] for i in views), self.seen.only(views))

    @classmethod
    def of(cls, views: Sequence[BoardView]) -> _Bundle:
        """In squares of the board, so that a fit knows no metres."""
        side = min(float(np.ptp(view.points, axis=0).min()) for view in views)
        return cls(
            tuple(view.name for view in views),
            Observations.of([view.corners for view in views], [view.points / side for view in views]),
        )


def _distinct(views: Sequence[BoardView], longer: int) -> tuple[list[BoardView], list[tuple[str, str]]]:
    """Views that say something of their own; and (name, why) of the others."""
    kept: list[BoardView] = []
    dropped: list[tuple[str, str]] = []
    for view in views:
        twin = next((other for other in kept if _same(view, other, _SAME * longer)), None)
        if len(view.corners) < _FEWEST_CORNERS or np.ptp(view.points, axis=0).min() <= 0.0:
            dropped.append((view.name, f"only {len(view.corners)} corners"))
        elif twin is not None:
            dropped.append((view.name, f"the same view as {twin.name}"))
        else:
            kept.append(view)
    return kept, dropped


def _same(one: BoardView, other: BoardView, within: float) -> bool:
    """Whether every corner of the one has a corner of the other within so many px."""
    if np.hypot(*(one.corners.mean(0) - other.corners.mean(0))) > within or len(one.corners) != len(other.corners):
        return False
    gaps = np.hypot(*np.moveaxis(one.corners[:, None] - other.corners, -1, 0))
    return bool(gaps.min(1).max() <= within)


def _first_fit(seen: Observations, size: tuple[int, int], circle: Circle | None) -> Fit | None:
    """The best of several starts, adjusted with all views; None where no lens could have taken them."""
    tolerance = _COARSE * max(size)
    few = seen.only(np.unique(np.linspace(0, len(seen.starts) - 1, _TRIED_ON).astype(int)))
    lenses = lens_start.likeliest(few, _centres(size, circle))[:_STARTS]
    starts = [start for lens in lenses if (start := lens_start.posed(lens, seen)) is not None]
    fits = [adjust(start, seen, tolerance) for start in starts]
    return min(fits, key=lambda fit: cost(fit, seen, tolerance), default=None)


def _centres(size: tuple[int, int], circle: Circle | None) -> list[Floats]:
    """Where the optical axis may be, px."""
    middle = (np.array(size) - 1.0) / 2.0
    if circle is not None:
        return [np.array(circle[:2]), middle]
    return [middle + min(size) * np.array([x, y]) for x in _OFF_CENTRE for y in _OFF_CENTRE if not (x and y)]


def _without_outliers(bundle: _Bundle, fit: Fit, longer: int, dropped: list[tuple[str, str]]) -> tuple[_Bundle, Fit]:
    """Adjusted again without views, then without corners, that contradict the others; `dropped` gets the views."""
    for _ in range(_ROUNDS):
        off = fit.view_median(bundle.seen)
        bad = off > max(_BAD_VIEW * float(np.median(off)), _BAD * longer)
        if not bad.any() or (~bad).sum() < FEWEST_VIEWS:
            break
        usual = f"where {np.median(off):.2g} is usual"
        dropped += [(bundle.names[i], f"{off[i]:.2g} px off, {usual}") for i in np.flatnonzero(bad)]
        bundle, fit = bundle.only(np.flatnonzero(~bad)), fit.only(np.flatnonzero(~bad))
        fit = adjust(fit, bundle.seen, TOLERANCE * fit.spread(bundle.seen))
    off = np.hypot(*fit.residuals(bundle.seen).T)
    seen = bundle.seen.without(off > max(_OUTLIER * fit.spread(bundle.seen), _BAD * longer))
    return replace(bundle, seen=seen), adjust(fit, seen, TOLERANCE * fit.spread(seen))


def _result(
    fit: Fit,
    bundle: _Bundle,
    dropped: list[tuple[str, str]],
    contradicting: int,
    size: tuple[int, int],
    circle: Circle | None,
) -> LensResult:
    evidence = evidence_of(fit, bundle.seen, size, circle)
    verdict, sentence = judge(evidence, len(bundle.names), contradicting)
    fx, fy, cx, cy, k1, k2, k3, k4 = fit.lens.tolist()
    return LensResult(
        width=size[0],
        height=size[1],
        camera_matrix=(fx, fy, cx, cy),
        distortion=(k1, k2, k3, k4),
        rms=evidence.rms,
        view_rms=tuple(zip(bundle.names, fit.view_rms(bundle.seen).tolist(), strict=True)),
        dropped=tuple(dropped),
        covered=evidence.covered,
        coverage=evidence.coverage,
        edge_sigma=evidence.edge_sigma,
        fov=evidence.fov,
        verdict=verdict,
        sentence=sentence,
    )


def _refused(sentence: str, dropped: list[tuple[str, str]], size: tuple[int, int]) -> LensResult:
    """Of no lens at all."""
    nan = math.nan
    return LensResult(
        *size, (nan,) * 4, (nan,) * 4, nan, (), tuple(dropped), 0.0, 0.0, math.inf, nan, Verdict.REJECTED, sentence
    )
