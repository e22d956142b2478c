"""tools/reproduce: the tables and figures of the thesis again, each beside what it printed.

Writes NAME.json and NAME.png for each into a folder. tools/reproduction/README.md says what came of it and why some of
it differs; --page puts a folder's results into that page.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
from matplotlib.figure import Figure

from tools.reproduction.item import Item, NotPossible, Outcome, written
from tools.reproduction.page import PAGE, PageError, write_page
from tools.reproduction.registry import GROUPS, ITEMS

OUT = Path("out/reproduce")
JOBS = 2  # groups at a time: with them all tables take less than an hour on two cores
_WIDTH = 116  # of a terminal's line


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status 1 where an acceptance is missed, unless `--quick`, which is not judged."""
    options = _parse(arguments)
    if options.list:
        print("\n".join(f"{item.name:<14}{item.title}" for item in ITEMS))
        return 0
    if options.page:
        return _write_page(options.out)
    options.out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    chosen = {item.name for item in ITEMS if options.all or item.name in options.names}
    rows = _reproduced(chosen, options.quick, options.out)
    print(f"{len(rows)} reproduced in {time.perf_counter() - began:.0f} s, written to {options.out}")
    missed = [row["name"] for row in rows if not row["met"]]
    if options.quick:
        print("quick: acceptance is not judged by so little")
    elif missed:
        print(f"acceptance missed: {', '.join(missed)}")
    return 1 if missed and not options.quick else 0


def _write_page(out: Path) -> int:
    try:
        names = write_page(out, PAGE)
    except (OSError, PageError) as error:
        print(f"reproduce: {error}", file=sys.stderr)
        return 1
    print(f"{len(names)} tables and figures put into {PAGE}")
    return 0


def _reproduced(chosen: set[str], quick: bool, out: Path) -> list[dict[str, Any]]:
    """Rows of the summary, in the thesis' order."""
    groups = [names for group in GROUPS if (names := [item.name for item in group if item.name in chosen])]
    if len(groups) == 1:
        return _group(groups[0], quick, out)
    with ProcessPoolExecutor(JOBS, get_context("spawn")) as workers:
        # The thesis' later chapters take longest: begun first, none of them is left to run alone at the end.
        made = [workers.submit(_group, names, quick, out) for names in reversed(groups)]
        return [row for group in reversed(made) for row in group.result()]


def _group(names: Sequence[str], quick: bool, out: Path) -> list[dict[str, Any]]:
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


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="tools/reproduce", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="as --list gives them")
    parser.add_argument("--all", action="store_true", help="every one, under an hour on two cores")
    parser.add_argument("--list", action="store_true", help="names and titles, and no more")
    parser.add_argument("--quick", action="store_true", help="seconds each: shows that it runs, not what comes of it")
    parser.add_argument("--page", action="store_true", help=f"put what lies in the folder into {PAGE}")
    parser.add_argument("--out", type=Path, default=OUT, metavar="FOLDER", help="default: %(default)s")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - {item.name for item in ITEMS})
    if unknown:
        parser.error(f"no {unknown[0]!r}; tools/reproduce --list names what there is")
    if not (options.names or options.all or options.list or options.page):
        parser.error("name tables and figures, or give --all, --list or --page")
    return options


if __name__ == "__main__":
    sys.exit(main())
