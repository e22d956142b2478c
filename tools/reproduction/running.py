"""Runs tables and figures: prints each and writes JSON and PNG. Worker processes load this module by its name."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
from matplotlib.figure import Figure

from tools.reproduction.item import Item, NotPossible, Outcome, written
from tools.reproduction.registry import ITEMS

_WIDTH = 116  # of a terminal's line


def reproduce_group(names: Sequence[str], quick: bool, out: Path) -> list[dict[str, Any]]:
    """In one process, for items of a group share measurements."""
    cv2.setNumThreads(1)
    return [_reproduce(item, quick, out) for item in ITEMS if item.name in names]


def _reproduce(item: Item, quick: bool, out: Path) -> dict[str, Any]:
    """Runs one, prints it and writes it; its row of the summary."""
    began = time.perf_counter()
    try:
        outcome = item.run(quick)
    except NotPossible as error:
        return _not_possible(item, error)
    seconds = time.perf_counter() - began
    print(as_text(item, outcome, seconds, judged=not quick), flush=True)
    row = _row(item, outcome, seconds)
    (out / f"{item.name}.json").write_text(json.dumps(row | {"data": outcome.data}, indent=1) + "\n", "utf-8")
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    item.draw(outcome.data, figure)
    written(figure, out / f"{item.name}.png")
    return row


def _not_possible(item: Item, error: NotPossible) -> dict[str, Any]:
    """Nothing is written: what an earlier run left stays."""
    print(f"{item.name}  {item.title}: not possible: {error}\n", flush=True)
    return {"name": item.name, "met": False, "seconds": 0.0}


def _row(item: Item, outcome: Outcome, seconds: float) -> dict[str, Any]:
    return {
        "name": item.name,
        "title": item.title,
        "differs": item.differs,
        "compared": [asdict(one) for one in outcome.compared],
        "checks": [asdict(check) for check in outcome.checks],
        "met": all(check.met for check in outcome.checks),
        "seconds": round(seconds, 1),
    }


def as_text(item: Item, outcome: Outcome, seconds: float, *, judged: bool = True) -> str:
    """For a terminal: figures side by side, what differs, and where it is judged what was asked for."""
    lines = [f"{item.name}  {item.title}  ({seconds:.0f} s)", _columns("", "thesis", "ours")]
    lines += [_columns(one.what, one.thesis, one.ours) for one in outcome.compared]
    lines += [f"  differs: {why}" for why in item.differs]
    if judged:
        lines += [f"  {'met' if check.met else 'MISSED'}: {check.wanted}: {check.found}" for check in outcome.checks]
    return "\n".join(lines) + "\n"


def _columns(what: str, thesis: str, ours: str) -> str:
    wide = (_WIDTH - 4) // 2
    return f"  {what:<{wide - 4}}{thesis:<{wide // 2 - 2}}  {ours}".rstrip()
