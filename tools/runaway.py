"""How long do the wheels turn when the daemon is gone? (launcher: tools/runaway)

The real daemon drives a simulated robot over a real pty. At a random moment of a drive it is killed, alone or with all
its processes, suspended, hung, told to end, or the cable is pulled; the robot, a process of its own, tells how long its
motors were on and its wheels turned afterwards, and how far it rolled. Then the daemon goes on or is started anew, or
the cable is put back: does anything move again?
"""

from __future__ import annotations

import argparse
import json
import signal
import statistics
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tools.runaway_bench import CUTS, LIMIT, Run, RunawayError, bench
from tools.sim.emulators import BODIES


def measure(base: str, job: str, cuts: Sequence[str], seed: int) -> Iterator[Run]:
    """One after the other."""
    if not cuts:
        return
    with bench(base, job, seed) as made:
        for number, cut in enumerate(cuts, 1):
            run = made.run(cut)
            print(
                f"{number:4}/{len(cuts)} {base} {cut}: {spoken(run.seconds)}, {run.metres * 100:.1f} cm",
                file=sys.stderr,
            )
            yield run


def missing(base: str, job: str, cuts: Sequence[str], wanted: int, runs: Sequence[Run]) -> list[str]:
    """Kinds of the cuts to come, in turn, until each has its share of `wanted`."""
    done = Counter(run.cut for run in runs if (run.base, run.job) == (base, job))
    share = Counter(cuts[number % len(cuts)] for number in range(wanted))
    return [cut for number in range(wanted) for cut in cuts if done[cut] <= number < share[cut]]


def spoken(seconds: float) -> str:
    return "for ever" if seconds >= LIMIT else f"{seconds:.2f} s"


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row a base and cut."""
    rows = []
    for base, cut in dict.fromkeys((run.base, run.cut) for run in runs):
        these = [run for run in runs if (run.base, run.cut) == (base, cut)]
        seconds = [run.seconds for run in these]
        row = {"base": base, "cut": cut, "runs": len(these), "median_s": statistics.median(seconds)}
        worst = {"worst_s": max(seconds), "worst_motors_s": max(run.motors for run in these)}
        worst["worst_m"] = max(run.metres for run in these)
        rows.append({**row, **worst, "moved_again": sum(run.moved_again for run in these)})
    return rows


def table(rows: Sequence[dict[str, Any]]) -> str:
    lines = [
        f"{'base':15} {'cut':9} {'runs':>4}  {'median':>8}  {'worst':>8}  {'motors':>8}  {'rolled':>8}  moved again"
    ]
    for row in rows:
        times = "  ".join(f"{spoken(row[key]):>8}" for key in ("median_s", "worst_s", "worst_motors_s"))
        rolled = f"{row['worst_m'] * 100:6.1f}cm" + ("+" if row["worst_s"] >= LIMIT else " ")
        lines.append(f"{row['base']:15} {row['cut']:9} {row['runs']:4}  {times}  {rolled}  {row['moved_again']:6}")
    return "\n".join(lines)


def kept(path: Path | None) -> list[Run]:
    """Of an earlier call that was interrupted."""
    if path is None or not path.exists():
        return []
    return [Run(**json.loads(line)) for line in path.read_text().splitlines()]


def keep(path: Path | None, run: Run) -> None:
    if path is not None:
        with path.open("a") as file:
            file.write(json.dumps(asdict(run)) + "\n")


def main() -> int:
    """Exit status 1 where the set-up failed; what the wheels did is for the reader to judge."""
    parser = argparse.ArgumentParser(prog="tools/runaway", description=__doc__)
    parser.add_argument("--base", action="append", choices=tuple(BODIES), help="again for another; default: all")
    parser.add_argument("--runs", type=int, default=len(CUTS), help="cuts of each base, the kinds in turn")
    parser.add_argument("--job", choices=("goto", "drive"), default="goto")
    parser.add_argument("--cut", action="append", choices=CUTS, help="again for another; default: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", type=Path, metavar="FILE", help="append each cut; those that stand there count")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the table and its rows")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # or robot and daemon would be left behind
    runs = kept(options.rows)
    try:
        for base in options.base or BODIES:
            cuts = missing(base, options.job, options.cut or CUTS, options.runs, runs)
            for run in measure(base, options.job, cuts, options.seed + len(runs)):
                keep(options.rows, run)
                runs.append(run)
    except RunawayError as error:
        print(f"tools/runaway: {error}", file=sys.stderr)
        return 1
    rows = summary(runs)
    print(table(rows))
    if options.json:
        told = {"limit_s": LIMIT, "summary": rows, "runs": [asdict(run) for run in runs]}
        options.json.write_text(json.dumps(told, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
