"""Pictures of results: errors, reliability of the confidence, and the floor seen from above."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from tools.evaluation.summary import ELSEWHERE

GOOD, BAD, INK, FAINT = "#2a7fa5", "#c8352f", "#444444", "#cccccc"
CENTIMETRES = 100.0
NEAR_CM, FAR_CM = 25.0, 50.0  # shown up to the first unless some error is larger; what is farther is at the edge

mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": INK})


def draw_runs(result: Mapping[str, Any], path: Path) -> None:
    """One experiment: error distribution, reliability diagram (of docking: errors of the heading), top view with the
    failures marked."""
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    errors, reliability, floor = figure.subplots(1, 3)
    meta = result["meta"]
    conditions = ", ".join(meta["conditions"]) or "nominal"
    figure.suptitle(
        f"{meta['experiment']}, {meta['world']}, seed {meta['seed']}, preset {meta['preset']}, "
        f"taught {meta['teach_s']:.0f} s, {conditions}"
    )
    if "docking" in result["summary"]:
        _docked(errors, reliability, result["runs"])
    else:
        _errors(errors, _by_condition(result["runs"]))
        draw_reliability(reliability, result["summary"]["calibration"])
    _floor(floor, result["runs"], meta["bounds"])
    figure.savefig(path, dpi=110)


def draw_reliability(axes: Axes, calibration: Mapping[str, Any]) -> None:
    """How often a confidence was right, against what it said; discs as large as what they stand for."""
    bins = calibration["bins"]
    axes.plot([0, 1], [0, 1], color=FAINT, zorder=0)
    sizes = [12.0 + 400.0 * b["count"] / max(calibration["n"], 1) for b in bins]
    said, right = [b["confidence"] for b in bins], [b["right"] for b in bins]
    axes.plot(said, right, color=GOOD, linewidth=1)
    axes.scatter(said, right, s=sizes, color=GOOD, alpha=0.7)
    axes.set(xlim=(-0.02, 1.05), ylim=(-0.02, 1.05), xlabel="confidence", ylabel="share within 0.25 m")
    axes.set_title(f"{calibration['n']} place estimates, calibration error {calibration['error']:.3f}", fontsize=9)


def draw_cumulative(axes: Axes, series: Mapping[str, Sequence[float]]) -> None:
    """Share of the runs (%) within a distance of the goal, one line a name."""
    shown = _shown(series)
    for name, errors in series.items():
        ordered = np.minimum(np.sort(errors) * CENTIMETRES, shown)
        shares = 100.0 * np.arange(1, len(ordered) + 1) / len(ordered)
        label = f"{name}: median {np.median(errors) * CENTIMETRES:.1f} cm"
        axes.step(np.append(0.0, ordered), np.append(0.0, shares), where="post", label=label)
    axes.axvline(15.0, color=FAINT, zorder=0)
    axes.set(xlim=(0.0, shown), ylim=(0.0, 102.0), xlabel="error at the goal (cm)", ylabel="runs within (%)")
    axes.legend(loc="lower right", fontsize=8, frameon=False)


def _errors(axes: Axes, runs: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    series = {name: [run["error_m"] for run in some] for name, some in runs.items()}
    draw_cumulative(axes, series)
    below = axes.twinx()
    everything = np.minimum(np.concatenate(list(series.values())) * CENTIMETRES, _shown(series))
    below.hist(everything, bins=np.arange(0.0, _shown(series) + 1.0, 1.0), color=GOOD, alpha=0.25)
    below.set_ylabel("runs a centimetre")


def _docked(metres: Axes, degrees: Axes, runs: Sequence[Mapping[str, Any]]) -> None:
    """Where those that said they docked stood: the thesis' figure 7.6."""
    said = [run for run in runs if run["result"] == "DOCKED"]
    for axes, values, unit, what in (
        (metres, [1000.0 * run["error_m"] for run in said], "mm", "position"),
        (degrees, [float(np.degrees(run["error_rad"])) for run in said], "°", "heading"),
    ):
        axes.hist(values, bins=20, color=GOOD)
        axes.set(xlabel=f"error of the {what} ({unit})", ylabel="runs", xlim=(0.0, None))
        mean = f"mean {np.mean(values):.2f} {unit}" if values else "none"
        axes.set_title(f"{len(said)} of {len(runs)} docked, {mean}", fontsize=9)


def _shown(series: Mapping[str, Sequence[float]]) -> float:
    """Centimetres to show."""
    return NEAR_CM if CENTIMETRES * max(map(max, series.values())) < NEAR_CM else FAR_CM


def _floor(axes: Axes, runs: Sequence[Mapping[str, Any]], bounds: Sequence[float]) -> None:
    """Goals, where the runs began (small) and ended; from goal to end a line, red for failures."""
    for run in runs:
        good = run["result"] in ("ARRIVED", "DOCKED") and run["error_m"] <= ELSEWHERE
        start, goal, final = run.get("carried_to", run["start"]), run["goal"], run["final"]
        axes.plot([start[0]], [start[1]], ".", color=FAINT, markersize=3)
        axes.plot([goal[0]], [goal[1]], "+", color=INK, markersize=4)
        colour = GOOD if good else BAD
        axes.plot([goal[0], final[0]], [goal[1], final[1]], color=colour, linewidth=1)
        axes.plot([final[0]], [final[1]], "o" if good else "x", color=colour, markersize=3 if good else 7)
    failed = sum(run["result"] not in ("ARRIVED", "DOCKED") for run in runs)
    wrong = sum(run["result"] in ("ARRIVED", "DOCKED") and run["error_m"] > ELSEWHERE for run in runs)
    xmin, ymin, xmax, ymax = bounds
    axes.plot([xmin, xmax, xmax, xmin, xmin], [ymin, ymin, ymax, ymax, ymin], color=FAINT)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.set_title(f"goals +, starts ·, ends o; x: {failed} failed, {wrong} at a wrong place", fontsize=9)


def _by_condition(runs: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for run in runs:
        groups.setdefault(run["condition"], []).append(run)
    return groups


def draw_table(results: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Many experiments: errors by preset and condition, reliability of them all, accuracy against teaching time."""
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    errors, reliability, teaching = figure.subplots(1, 3)
    draw_cumulative(errors, _series(results, _preset_and_condition))
    draw_reliability(reliability, pooled([result["summary"]["calibration"] for result in results]))
    _teaching(teaching, results)
    figure.savefig(path, dpi=110)


def pooled(calibrations: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The calibration of all their estimates together."""
    bins: dict[float, list[Mapping[str, Any]]] = {}
    for some in (b for calibration in calibrations for b in calibration["bins"]):
        bins.setdefault(some["low"], []).append(some)
    merged = [_merged(bins[low]) for low in sorted(bins)]
    n = sum(b["count"] for b in merged)
    return {"n": n, "error": sum(b["count"] * abs(b["right"] - b["confidence"]) for b in merged) / n, "bins": merged}


def _merged(bins: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    count = sum(b["count"] for b in bins)
    means = {key: sum(b["count"] * b[key] for b in bins) / count for key in ("confidence", "right")}
    return {**means, "count": count}


def _series(results: Sequence[Mapping[str, Any]], name: Callable[..., str]) -> dict[str, list[float]]:
    series: dict[str, list[float]] = {}
    for result in results:
        for run in result["runs"]:
            series.setdefault(name(result["meta"], run), []).append(run["error_m"])
    return series


def _preset_and_condition(meta: Mapping[str, Any], run: Mapping[str, Any]) -> str:
    return f"{meta['preset']}, {meta['experiment']}, {run['condition']}"


def _teaching(axes: Axes, results: Sequence[Mapping[str, Any]]) -> None:
    """Median and 95th percentile of `goto` under no condition against the length of the teaching drive."""
    lengths: set[float] = set()
    for preset, colour in (("default", GOOD), ("thesis", BAD)):
        plain = [r for r in results if r["meta"]["preset"] == preset and not r["meta"]["conditions"]]
        taught: dict[float, list[float]] = {}
        for result in (r for r in plain if r["meta"]["experiment"] == "goto"):
            taught.setdefault(result["meta"]["teach_s"], []).extend(run["error_m"] for run in result["runs"])
        lengths |= taught.keys()
        for share, style in ((50, "o-"), (95, "o--")) if taught else ():
            heights = [CENTIMETRES * float(np.percentile(taught[seconds], share)) for seconds in sorted(taught)]
            axes.plot(sorted(taught), heights, style, color=colour, label=f"{preset}, {share} % of the runs")
    axes.set(xscale="log", yscale="log", xlabel="teaching drive (s)", ylabel="error at the goal (cm)")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    if axes.lines:
        axes.set_xticks(sorted(lengths))
        axes.legend(fontsize=8, frameon=False)
