"""tools/reproduce: the tables and figures of the thesis again, each beside what it printed.

Writes NAME.json and NAME.png for each into a folder. tools/reproduction/README.md says what came of it and why some of
it differs; --page puts a folder's results into that page.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tools.reproduction.page import PAGE, PageError, write_page
from tools.reproduction.registry import GROUPS, ITEMS
from tools.reproduction.running import reproduce_group

OUT = Path("out/reproduce")
JOBS = 2  # groups at a time: with them all tables take less than an hour on two cores


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
        return reproduce_group(groups[0], quick, out)
    with ProcessPoolExecutor(JOBS, get_context("spawn")) as workers:
        # The thesis' later chapters take longest: begun first, none of them is left to run alone at the end.
        made = [workers.submit(reproduce_group, names, quick, out) for names in reversed(groups)]
        return [row for group in reversed(made) for row in group.result()]


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
