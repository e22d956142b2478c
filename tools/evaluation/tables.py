"""Many results as tables in Markdown: one of trips, one of docking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tools.evaluation.docking import figures
from tools.sim.conditions import STANDING, expanded

HEADINGS = (
    *("experiment", "world", "seed", "condition", "preset", "taught", "n", "median", "worst"),
    *("< 0.10 m", "< 0.15 m", "< 0.50 m", "heading", "LOST", "other failures", "wrong place", "calibration", "found"),
)


DOCKING_HEADINGS = (
    *("experiment", "world", "seed", "dock", "preset", "holds always", "only while docking", "knows its camera"),
    *(
        "docked",
        "mean",
        "worst",
        "heading, mean",
        "heading, worst",
        "within 2 cm, 1°",
        "false",
        "time, median",
        "steps",
    ),
)


def markdown(results: Sequence[Mapping[str, Any]]) -> str:
    """A row for each result, and below a result under several lights a row for each."""
    trips = [row for result in results if "docking" not in result["summary"] for row in _rows(result)]
    docking = [row for result in results if "docking" in result["summary"] for row in _docking_rows(result)]
    tables = [_table(HEADINGS, trips)] if trips else []
    return "\n\n".join([*tables, *([_table(DOCKING_HEADINGS, docking)] if docking else [])])


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    rule = ["---"] * len(headings)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [headings, rule, *rows])


def _docking_rows(result: Mapping[str, Any]) -> list[list[str]]:
    meta, summary = result["meta"], result["summary"]["docking"]
    place = "open" if meta["open"] else "wall"
    what = [meta["experiment"], meta["world"], str(meta["seed"]), place, meta["homing"] or meta["preset"]]
    known = {"own": "by its own spin", "known": "told the truth", "none": "no"}[meta["calibration"]]
    parts = summary.get("by_condition", {})
    together = [*what, *_conditions(meta["conditions"]), known, *figures(summary).values()]
    return [together, *([*what, "", name, known, *figures(part).values()] for name, part in parts.items())]


def _conditions(names: Sequence[str]) -> tuple[str, str]:
    """Those that hold while teaching, too, and those that came after the dock was saved."""
    if "disturbed" in names:
        names = [*expanded(names)[1:], "another light"]
    always = ", ".join(name for name in names if name in STANDING)
    return always or "nominal", ", ".join(name for name in names if name not in STANDING) or "nominal"


def _rows(result: Mapping[str, Any]) -> list[list[str]]:
    meta, summary = result["meta"], result["summary"]
    what = [meta["experiment"], meta["world"], str(meta["seed"])]
    how = [meta["preset"], f"{meta['teach_s']:.0f} s"]
    error = f"{summary['calibration']['error']:.3f}"
    parts = summary.get("by_condition", {})
    condition = "all" if parts else ",".join(meta["conditions"]) or "nominal"
    together = [*what, condition, *how, *_figures(summary), error, _found(summary)]
    return [together, *([*what, name, *how, *_figures(part), "", ""] for name, part in parts.items())]


def _figures(summary: Mapping[str, Any]) -> list[str]:
    within, results = summary["within"], summary["results"]
    done = sum(results.get(name, 0) for name in ("ARRIVED", "DOCKED", "LOST"))
    shares = [f"{100 * within[limit]:.1f} %" for limit in ("0.10", "0.15", "0.50")]
    lengths = [f"{100 * summary[name]:.3g} cm" for name in ("median_m", "max_m")]
    counts = [str(summary["lost"]), str(summary["n"] - done), str(summary["false_arrivals"])]
    return [str(summary["n"]), *lengths, *shares, f"{summary['median_deg']:.2f}°", *counts]


def _found(summary: Mapping[str, Any]) -> str:
    """Of the carried robots: how many found themselves again, and how fast."""
    again = summary.get("recovery")
    if again is None:
        return ""
    when = "" if again["median_s"] is None else f", {again['median_s']:.1f} s"
    return f"{again['recovered']}/{again['n']}{when}"
