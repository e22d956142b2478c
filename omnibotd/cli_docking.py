"""The verbs `dock` and `undock`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from typing import Any

from omnibotd import cli_output
from omnibotd.cli_verbs import UsageError, Verb, simple


def dock(terminal: Any, options: argparse.Namespace) -> None:
    words = list(options.words)
    saves = words[:1] == ["save"]
    _check(words, saves, options)
    run: Verb
    if saves:
        run = simple("dock.save", "saving the dock", _saved, "name", "fresh")
    elif options.trials is not None:
        run = simple("dock", "docking", trials, "name", "trials", job=True)
    else:
        run = simple("dock", "docking", _docked, "name", job=True)
    name = words[-1] if words else None
    run(terminal, argparse.Namespace(name=name, fresh=options.fresh, trials=options.trials))


def _check(words: list[str], saves: bool, options: argparse.Namespace) -> None:
    if saves and len(words) != 2:
        raise UsageError("dock save: name the dock")
    if saves and options.trials is not None:
        raise UsageError("dock save: --trials goes with dock alone")
    if not saves and len(words) > 1:
        raise UsageError("dock: at most one name; to save one say dock save NAME")
    if not saves and options.fresh:
        raise UsageError("dock: --fresh goes with dock save")


def undocked(result: Mapping[str, Any]) -> str:
    place = f" of {result['dock']}" if result.get("dock") else ""
    return f"out{place}, {result['distance_m']:.2f} m back, after {cli_output.duration(result['seconds'])}"


def _saved(result: Mapping[str, Any]) -> str:
    place = f"{result['name']} saved at {cli_output.pose(result.get('pose'))}"
    if not result.get("added"):
        return place
    offset = result.get("offset") or {"x": 0.0, "y": 0.0}
    away = 1000.0 * math.hypot(offset["x"], offset["y"])
    return f"{place}: another view, {result['views']} in all, taken {away:.0f} mm from the first"


def _docked(result: Mapping[str, Any]) -> str:
    offset = result.get("offset")
    where = f", {_millimetres(offset)} off" if offset else ""
    retries = result["retries"]
    again = f", {retries} {'retry' if retries == 1 else 'retries'}" if retries else ""
    return f"docked at {result['dock']} after {cli_output.duration(result['seconds'])}{again}{where}"


def trials(result: Mapping[str, Any]) -> str:
    """Every trial as a row, then mean and spread of those that docked."""
    head = ("TRIAL", "RESULT", "AFTER", "RETRIES", "X mm", "Y mm", "YAW \N{DEGREE SIGN}")
    rows = [
        (entry["trial"], entry["result"], f"{entry['seconds']:.1f} s", entry["retries"], *_cells(entry.get("offset")))
        for entry in result["trials"]
    ]
    if result["docked"]:
        rows += [_statistics("mean", result["mean"]), _statistics("sd", result["sd"])]
    table = cli_output.table([head, *rows], right=(0, 2, 3, 4, 5, 6))
    return f"{table}\ndocked at {result['dock']} in {result['docked']} of {len(result['trials'])} trials"


def _statistics(name: str, values: Mapping[str, Any]) -> tuple[Any, ...]:
    retries = values.get("retries")
    seconds = f"{values['seconds']:.1f} s" if values.get("seconds") is not None else ""
    return (name, "", seconds, "-" if retries is None else f"{retries:.2f}", *_cells(values))


def _cells(pose: Mapping[str, Any] | None) -> tuple[str, str, str]:
    if pose is None or pose.get("x") is None:
        return ("-", "-", "-")
    return f"{1000 * pose['x']:.1f}", f"{1000 * pose['y']:.1f}", f"{math.degrees(pose['yaw']):.2f}"


def _millimetres(pose: Mapping[str, Any]) -> str:
    away = 1000.0 * math.hypot(pose["x"], pose["y"])
    return f"{away:.1f} mm and {abs(math.degrees(pose['yaw'])):.2f}\N{DEGREE SIGN}"
