"""Conical mirrors (thesis, sections 2.3 and 4.6): what crookedness costs stereo, and what the general formulae save."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from omnibotd.core.optics.aligned import stereo_range
from omnibotd.core.optics.calibration import calibrate_pair
from omnibotd.core.optics.camera import Pinhole
from omnibotd.core.optics.cone import Cone
from omnibotd.core.optics.rigid import Rigid
from omnibotd.core.optics.sensor import ConeSensor
from omnibotd.core.optics.stereo import StereoPair
from tools.reproduction.item import Check, Compared, Item, Outcome

Floats = NDArray[np.float64]
# The specification's example: lens to tip, tip to tip, m; focal length, px; the range asked for, m.
LENS, SEPARATION, FOCAL, RANGE = 0.10, 0.25, 600.0, 2.0
LOWER = ConeSensor.aligned(Cone(0.05), Pinhole(FOCAL, 320.0, 240.0), LENS)
PAIR = StereoPair(replace(LOWER, frame_from_cone=Rigid.of(shift=(0.0, 0.0, SEPARATION))), LOWER)
# The specification does not say how far below the mirrors its points are. Tilt costs with the square of the image
# distance, so its figure for 1 degree needs deep ones, which only a mirror wider than the thesis' shows.
DEEPEST = 1.0
WIDE_PAIR = StereoPair(*(replace(s, cone=Cone(1.0)) for s in (PAIR.upper, PAIR.lower)))
# (degrees, mm) of both cameras: the specification's three, then all up to what acceptance asks for.
STATED = {(1.0, 0.0): (0.9, 3.0), (0.0, 1.0): (6.0, 14.0), (0.0, 2.0): (12.0, 33.0)}
LADDER = (0.0, 0.1, 0.3, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0)
NOISE = 0.3  # px, of landmarks and of what is measured
LANDMARKS, MARKS = 60, 24
WAYS = ("aligned formula", "general, calibrated", "general, known")


def _measured(quick: bool) -> Outcome:
    """Round trips, the specification's three figures of the aligned formula, and errors against misalignment."""
    trips = _round_trips(1000 if quick else 10_000)
    stated = [_stated(off, said, 60 if quick else 300) for off, said in STATED.items()]
    ladder = [_rung(size, 2 if quick else 8) for size in LADDER]
    worst = ladder[-1]
    compared = [
        Compared(
            f"aligned formula, {row['tilt_deg']:g}°, {row['offset_mm']:g} mm",
            _errors_of(row["said"]),
            _errors_of(row["ours"]),
        )
        for row in stated
    ]
    compared += [
        Compared(
            f"{way}, {worst['size']:g}° and mm", "-", _errors_of([100.0 * error for error in worst["errors"][way]])
        )
        for way in WAYS
    ]
    found = f"{trips['not_converged']} of {trips['cases']} failed, worst {trips['worst_px']:.1e} px"
    checks = [Check("spec 04, 10.5: round trip <= 1e-6 px up to 10°, 10 mm, all converge", found, trips["passed"])]
    checks += [
        Check(
            f"spec 02, 7: {row['tilt_deg']:g}°, {row['offset_mm']:g} mm, factor 1.5 of {_errors_of(row['said'])}",
            _errors_of(row["ours"]),
            row["passed"],
        )
        for row in stated
    ]
    return Outcome(tuple(compared), tuple(checks), {"round_trip": trips, "stated": stated, "ladder": ladder})


def _errors_of(per_cent: Sequence[float]) -> str:
    median, ninth = per_cent
    return f"{median:.2g} %, 90th percentile {ninth:.2g} %"


def _round_trips(cases: int) -> dict[str, Any]:
    """Pixel to point and back, each hundred with a camera of its own, up to 10 degrees and 10 mm off."""
    rng = np.random.default_rng(1)
    errors: list[float] = []
    while len(errors) < cases:
        sensor = _crooked(rng, LOWER, *rng.uniform(0.0, 10.0, 2))
        radius, angle = rng.uniform(20.0, 230.0, 200), rng.uniform(-np.pi, np.pi, 200)
        pixels = sensor.tip() + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        sights = sensor.sights(pixels)
        ok = np.flatnonzero(np.isfinite(sights.origin[:, 0]))[: min(100, cases - len(errors))]
        points = sights.origin[ok] + rng.uniform(0.3, 8.0, (len(ok), 1)) * sights.direction[ok]
        errors.extend(np.linalg.norm(sensor.pixels(points) - pixels[ok], axis=1).tolist())
    failed = int(np.isnan(errors).sum())
    worst = float(np.nanmax(errors))
    return {"cases": cases, "not_converged": failed, "worst_px": worst, "passed": not failed and worst <= 1e-6}


def _stated(off: tuple[float, float], said: tuple[float, float], trials: int) -> dict[str, Any]:
    """The specification's median and 90th percentile of the aligned formula's error, per cent, and ours."""
    rng = np.random.default_rng(2)
    errors: list[float] = []
    while len(errors) < trials:
        pair = StereoPair(*(_crooked(rng, s, *off, sideways=True) for s in (WIDE_PAIR.upper, WIDE_PAIR.lower)))
        points = _marks(rng, 1, DEEPEST)
        shown = [sensor.pixels(points) for sensor in (pair.upper, pair.lower)]
        if np.isfinite(shown).all():
            errors.append(float(_aligned_errors(pair, shown)[0]))
    median, ninth = (100.0 * float(np.quantile(errors, q)) for q in (0.5, 0.9))
    within = all(1 / 1.5 <= ours / theirs <= 1.5 for ours, theirs in zip((median, ninth), said, strict=True))
    return {"tilt_deg": off[0], "offset_mm": off[1], "said": said, "ours": (median, ninth), "passed": within}


def _rung(size: float, trials: int) -> dict[str, Any]:
    """Relative range errors at `size` degrees and mm: median and 90th percentile of each way."""
    rng = np.random.default_rng((3, round(10 * size)))
    errors: dict[str, list[float]] = {way: [] for way in WAYS}
    lost = 0
    for _ in range(trials):
        pair = _crooked_pair(rng, size, size)
        points = _marks(rng, MARKS)
        exact = [sensor.pixels(points) for sensor in (pair.upper, pair.lower)]
        seen = np.isfinite(exact).all(axis=(0, 2))
        lost += int((~seen).sum())
        points, exact = points[seen], [pixels[seen] for pixels in exact]
        noisy = [pixels + rng.normal(scale=NOISE, size=pixels.shape) for pixels in exact]
        errors[WAYS[0]].extend(_aligned_errors(pair, exact).tolist())
        errors[WAYS[1]].extend(_errors(_calibrated(rng, pair), noisy).tolist())
        errors[WAYS[2]].extend(_errors(pair, exact).tolist())
    quantiles = {way: [float(np.quantile(some, q)) for q in (0.5, 0.9)] for way, some in errors.items()}
    return {"size": size, "errors": quantiles, "unseen": lost / (trials * MARKS)}


def _calibrated(rng: np.random.Generator, pair: StereoPair) -> StereoPair:
    """What landmarks round about, seen with noise, tell of the pair."""
    bearing, away = rng.uniform(-np.pi, np.pi, LANDMARKS), rng.uniform(0.6, 3.0, LANDMARKS)
    height = -rng.uniform(-0.1, 0.2, LANDMARKS) * away
    points = np.stack([away * np.cos(bearing), away * np.sin(bearing), height], axis=1)
    upper, lower = (s.pixels(points) + rng.normal(scale=NOISE, size=(LANDMARKS, 2)) for s in (pair.upper, pair.lower))
    return calibrate_pair(PAIR, points, upper, lower, NOISE).pair


def _marks(rng: np.random.Generator, count: int, deepest: float = 0.4) -> Floats:
    """Points at the range asked for, up to `deepest` m below the lower tip; those to 0.4 m both 5 cm mirrors show."""
    bearing, height = rng.uniform(-np.pi, np.pi, count), -rng.uniform(0.02, deepest, count)
    return np.stack([RANGE * np.cos(bearing), RANGE * np.sin(bearing), height], axis=1)


def _aligned_errors(pair: StereoPair, shown: Sequence[Floats]) -> Floats:
    """Relative errors by Eq 2.1, the tip's picture taken for the centre; no range at all counts as wholly wrong."""
    upper, lower = (
        np.linalg.norm(pixels - sensor.tip(), axis=1)
        for sensor, pixels in zip((pair.upper, pair.lower), shown, strict=True)
    )
    return _relative(stereo_range(upper, lower, FOCAL, LENS, SEPARATION))


def _errors(pair: StereoPair, shown: Sequence[Floats]) -> Floats:
    return _relative(np.hypot(*pair.locate(*shown).points[:, :2].T))


def _relative(ranges: Floats) -> Floats:
    return np.asarray(np.nan_to_num(np.abs(ranges / RANGE - 1.0), nan=1.0), np.float64)


def _crooked_pair(rng: np.random.Generator, tilt_deg: float, offset_mm: float) -> StereoPair:
    return StereoPair(*(_crooked(rng, sensor, tilt_deg, offset_mm) for sensor in (PAIR.upper, PAIR.lower)))


def _crooked(
    rng: np.random.Generator, sensor: ConeSensor, tilt_deg: float, offset_mm: float, *, sideways: bool = False
) -> ConeSensor:
    """The sensor with its camera off by so much, about and along random (`sideways`: horizontal) directions."""
    space = np.array([1.0, 1.0, 0.0 if sideways else 1.0])
    about, along = (v / np.linalg.norm(v) for v in space * rng.normal(size=(2, 3)))
    turned, pose = Rigid.of(np.radians(tilt_deg) * about), sensor.cone_from_camera
    moved = Rigid(turned.rotation @ pose.rotation, pose.translation + 1e-3 * offset_mm * along)
    return replace(sensor, cone_from_camera=moved)


def _draw(data: Mapping[str, Any], figure: Figure) -> None:
    """Range error against misalignment, medians with 90th percentiles above."""
    axes = figure.subplots()
    ladder = data["ladder"]
    for way, colour in zip(WAYS, ("#c8352f", "#2a7fa5", "#444444"), strict=True):
        median, ninth = np.array([rung["errors"][way] for rung in ladder]).T
        sizes = [rung["size"] for rung in ladder]
        axes.plot(sizes, np.maximum(median, 1e-16), color=colour, marker="o", markersize=3, label=way)
        axes.fill_between(sizes, np.maximum(median, 1e-16), np.maximum(ninth, 1e-16), color=colour, alpha=0.2, lw=0)
    axes.set(yscale="log", xlabel="misalignment of both cameras (degrees and mm)", ylabel="relative range error")
    axes.set_title(f"Stereo at {RANGE:g} m: median, and up to the 90th percentile", fontsize=10)
    axes.legend(frameon=False, fontsize=8)


ITEMS = (
    Item(
        "mirrors",
        "conical mirrors: round trips, and stereo against misalignment",
        ("the thesis gives formulae and no figures: those beside ours are the specification's own trials (02, 2)",),
        _measured,
        _draw,
    ),
)
