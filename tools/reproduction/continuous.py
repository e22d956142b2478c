"""Figures 6.12 to 6.14: the thesis' continuous navigation, to one goal, to random ones, round a route (§6.5.6)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any
from unittest import mock

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omnibotd.core.thesis.offset_filter import OffsetFilter
from tools.evaluation.plots import BAD, FAINT, GOOD
from tools.reproduction.daemon_runs import Course, evaluated
from tools.reproduction.item import Check, Compared, Item, Outcome, standard_error

WORLD, SEED = "tools.sim.reporting:slats", 101  # a room that nothing was tuned on
# s of teaching: as in the thesis, 500 for the SOM and 4000 for the nodes.
TEACHING, QUICK_TEACHING = 4500.0, 60.0
# The thesis made 300 trips to random goals and 15 loops: with half as many all tables take less than an hour.
STARTS, GOALS, LOOPS, WAYPOINTS = 15, 150, 8, 5
DIFFERS = (
    f"simulated: the whole daemon with `preset: thesis` in a rendered room ({WORLD}, seed {SEED}); the room is not "
    "the thesis', and its ceiling is level and evenly lit",
    f"{GOALS} random goals, not 300, and {LOOPS} loops, not 15, so that all tables take less than an hour",
    "link variances, the similarity threshold and the dynamic window's settings are not printed",
)


@contextmanager
def _traced() -> Iterator[list[list[tuple[float, ...]]]]:
    """For each trip a list of (measured x, y, filtered x, y, standard deviation), a cycle each."""
    trips: list[list[tuple[float, ...]]] = []
    begin, update = OffsetFilter.__init__, OffsetFilter.update

    def begun(self: OffsetFilter, z: tuple[float, float], r: float) -> None:
        begin(self, z, r)
        trips.append([])

    def updated(self: OffsetFilter, z: tuple[float, float], r: float) -> None:
        update(self, z, r)
        trips[-1].append((*z, *self.offset, math.sqrt(self.variance)))

    with mock.patch.object(OffsetFilter, "__init__", begun), mock.patch.object(OffsetFilter, "update", updated):
        yield trips


@cache
def _to_one_goal(quick: bool) -> dict[str, Any]:
    with _traced() as trips:
        result = _evaluated("starts", quick, 1 if quick else STARTS)
    return result | {"filter": max(trips, key=len)}


@cache
def _evaluated(experiment: str, quick: bool, runs: int) -> dict[str, Any]:
    result = evaluated(experiment, Course(WORLD, SEED, "thesis", QUICK_TEACHING if quick else TEACHING), runs)
    return {"runs": result["runs"], "bounds": result["meta"]["bounds"], "nodes": result["meta"]["nodes"]}


def _goal(quick: bool) -> Outcome:
    data = _to_one_goal(quick)
    errors = _errors(data)
    closer = sum(run["error_m"] < math.dist(run["start"][:2], run["goal"][:2]) for run in data["runs"])
    trace = np.array(data["filter"])
    raw, smooth = (float(np.abs(np.diff(trace[:, k : k + 2], axis=0)).mean()) for k in (0, 2))
    return Outcome(
        (
            Compared(
                "position error, mean ± s.e.",
                "0.283 ± 0.027 m",
                f"{errors.mean():.3f} ± {standard_error(errors):.3f} m",
            ),
            Compared("least, greatest", "0.137 m, 0.456 m", f"{errors.min():.3f} m, {errors.max():.3f} m"),
            Compared("ended closer to the goal", "15 of 15", f"{closer} of {len(errors)}"),
            Compared("measured offset changes a cycle", "rough (6.12b)", f"{100 * raw:.1f} cm"),
            Compared("filtered offset changes a cycle", "smooth (6.12b)", f"{100 * smooth:.1f} cm"),
        ),
        (
            Check("spec 06, 12.3: all end closer", f"{closer} of {len(errors)}", closer == len(errors)),
            Check("spec 06, 12.3: mean <= 0.40 m", f"{errors.mean():.3f} m", bool(errors.mean() <= 0.40)),
            Check("spec 06, 12.5: filtered smoother than measured", f"{smooth / raw:.2f} times", smooth < raw),
        ),
        data,
    )


def _random(quick: bool) -> Outcome:
    data = _evaluated("goto", quick, 2 if quick else GOALS)
    errors = _errors(data)
    metre, half = (float((errors <= limit).mean()) for limit in (1.0, 0.5))
    off = np.array([np.subtract(run["final"][:2], run["goal"][:2]) for run in data["runs"]])
    (mx, my), (sx, sy) = off.mean(0), off.std(0, ddof=1)
    quantiles = ", ".join(f"{np.quantile(errors, q):.2f}" for q in (0.5, 0.9, 1.0))
    arrived = sum(run["result"] == "ARRIVED" for run in data["runs"])
    return Outcome(
        (
            Compared("navigations", "300", f"{len(errors)}, {arrived} stopped by the thesis' rule"),
            Compared("within 1 m, within 0.5 m", "88 %, 67 %", f"{metre:.0%}, {half:.0%}"),
            Compared("error in x, mean (s.d.)", "-0.0186 (0.5313) m", f"{mx:.4f} ({sx:.4f}) m"),
            Compared("error in y, mean (s.d.)", "0.045 (0.6012) m", f"{my:.4f} ({sy:.4f}) m"),
            Compared("median, 90 %, worst", "-", f"{quantiles} m"),
        ),
        (
            Check("spec 06, 12.3: 80 % within 1 m", f"{metre:.0%}", metre >= 0.8),
            Check("spec 06, 12.3: 55 % within 0.5 m", f"{half:.0%}", half >= 0.55),
        ),
        data,
    )


def _route(quick: bool) -> Outcome:
    data = _evaluated("route", quick, 1 if quick else LOOPS)
    errors = _errors(data)
    half, arrived = float((errors <= 0.5).mean()), sum(run["result"] == "ARRIVED" for run in data["runs"])
    return Outcome(
        (
            Compared("arrivals", f"{15 * WAYPOINTS} (15 loops)", f"{arrived} of {len(errors)}"),
            Compared("error at a way-point, mean", "not printed, all correct", f"{errors.mean():.3f} m"),
            Compared("within 0.5 m", "-", f"{half:.0%}"),
        ),
        (
            Check("spec 06, 12.4: all loops finished", f"{arrived} of {len(errors)}", arrived == len(errors)),
            Check("spec 06, 12.4: 60 % within 0.5 m", f"{half:.0%}", half >= 0.6),
        ),
        data,
    )


def _errors(data: Mapping[str, Any]) -> np.ndarray:
    return np.array([run["error_m"] for run in data["runs"]])


def _draw_goal(data: Mapping[str, Any], figure: Figure) -> None:
    floor, offset = figure.subplots(1, 2)
    _draw_floor(floor, data)
    trace = np.array(data["filter"])
    cycles = np.arange(len(trace))
    offset.plot(cycles, trace[:, 0], color=FAINT, label="measured")
    offset.plot(cycles, trace[:, 2], color=GOOD, label="filtered")
    low, high = trace[:, 2] - trace[:, 4], trace[:, 2] + trace[:, 4]
    offset.fill_between(cycles, low, high, color=GOOD, alpha=0.2, linewidth=0)
    offset.set(xlabel="cycle of the longest run", ylabel="offset in x to the goal (m), 1 s.d.")
    offset.legend(frameon=False, fontsize=8)


def _draw_random(data: Mapping[str, Any], figure: Figure) -> None:
    axes = figure.subplots()
    off = np.array([np.subtract(run["final"][:2], run["goal"][:2]) for run in data["runs"]])
    axes.plot(*off.T, ".", color=GOOD)
    axes.set(xlabel="error in x (m)", ylabel="error in y (m)", xlim=(-2.0, 2.0), ylim=(-2.0, 2.0), aspect="equal")
    axes.set_title(f"{len(off)} navigations; the thesis: s.d. 0.53 m and 0.60 m of 300", fontsize=9)


def _draw_route(data: Mapping[str, Any], figure: Figure) -> None:
    _draw_floor(figure.subplots(), data)


def _draw_floor(axes: Axes, data: Mapping[str, Any]) -> None:
    """Starts, ends and goals, each end with a line to its goal."""
    for run in data["runs"]:
        axes.plot(*zip(run["goal"][:2], run["final"][:2], strict=True), color=BAD, linewidth=0.8)
        axes.plot(*run["start"][:2], "o", color=FAINT, markersize=4)
        axes.plot(*run["final"][:2], "k.", markersize=4)
        axes.plot(*run["goal"][:2], "D", color=GOOD, markersize=6, fillstyle="none")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.set_title("goals (diamonds), where the runs ended (dots)", fontsize=9)


ITEMS = (
    Item("figure-6.12", "continuous navigation to one goal, and its filter", DIFFERS, _goal, _draw_goal),
    Item("figure-6.13", "continuous navigation to random goals", DIFFERS, _random, _draw_random),
    Item("figure-6.14", "continuous navigation round a route", DIFFERS, _route, _draw_route),
)
