"""tools/evaluate-all PLAN: runs many tools/evaluate, some at once, and makes a table, one JSON and pictures of them.

PLAN is a YAML list; each entry is a set of experiments. What it gives as a list is varied, every combination is run:

    - experiment: [goto, kidnap]
      world: [tools.sim.ceilings:tiles, tools.sim.ceilings:plain]
      seed: [1, 2]                   # default 1
      condition: [nominal, "people,slope"]
      preset: [default, thesis]      # default: default
      teach: [300, 900]              # s; default: the preset's
      homing: ["", orb]              # default: the preset's
      open: [false, true]            # docks at the wall, in the middle of the room; default: false
      runs: 100

Results already in the folder are kept, so that a table broken off can be continued; teaching is shared.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import yaml

from tools.evaluation.options import TEACHING
from tools.evaluation.tables import markdown

_CHECKOUT = Path(__file__).resolve().parents[2]
_KEYS = ("experiment", "world", "seed", "condition", "preset", "teach", "runs", "homing", "open")


class PlanError(Exception):
    """A plan that can't be run; the message says which entry and why."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One call of tools/evaluate."""

    experiment: str
    world: str
    seed: int
    condition: str
    preset: str
    teach: float
    runs: int
    homing: str = ""
    open: bool = False

    @property
    def name(self) -> str:
        """Of its files."""
        world = self.world.replace(":", ".")
        condition = self.condition.replace(",", "+")
        method = "-".join(filter(None, (self.preset, self.homing, "open" if self.open else "")))
        return f"{self.experiment}-{world}-{self.seed}-{condition}-{method}-{self.teach:g}-{self.runs}"

    @property
    def arguments(self) -> list[str]:
        options = {"world": self.world, "seed": self.seed, "condition": self.condition, "preset": self.preset}
        options |= {"teach": self.teach, "runs": self.runs} | ({"homing": self.homing} if self.homing else {})
        flags = ["--open"] if self.open else []
        return [self.experiment, *flags, *(text for key, value in options.items() for text in (f"--{key}", str(value)))]


def trials(plan: Any, teaching: Sequence[float] = ()) -> list[Trial]:
    """Every combination, without doubles; `teaching` (s) goes before what the plan says. Raises PlanError."""
    if not isinstance(plan, list) or not plan:
        raise PlanError("a plan is a list of entries, each with experiment, world and runs")
    return list(
        dict.fromkeys(trial for number, entry in enumerate(plan, 1) for trial in _spread(number, entry, teaching))
    )


def _spread(number: int, entry: Any, teaching: Sequence[float]) -> Iterator[Trial]:
    if not isinstance(entry, Mapping) or not {"experiment", "world", "runs"} <= entry.keys() <= set(_KEYS):
        raise PlanError(f"entry {number}: experiment, world and runs are needed, and {', '.join(_KEYS)} are known")
    many = {key: value if isinstance(value, list) else [value] for key, value in entry.items()}
    presets = many.get("preset", ["default"])
    unknown = [preset for preset in presets if preset not in TEACHING]
    if unknown:
        raise PlanError(f"entry {number}: no preset {unknown[0]!r}; there are {', '.join(TEACHING)}")
    for preset in presets:
        seconds = teaching or many.get("teach", [TEACHING[preset]])
        seeds, conditions = many.get("seed", [1]), many.get("condition", ["nominal"])
        # Neighbours share their teaching.
        ways = many.get("open", [False]), many.get("homing", [""])
        choices = product(many["world"], seeds, seconds, many["experiment"], conditions, many["runs"], *ways)
        for world, seed, teach, experiment, condition, runs, in_the_open, homing in choices:
            yield Trial(experiment, world, seed, condition, preset, float(teach), runs, homing, in_the_open)


def run_all(todo: Sequence[Trial], out: Path, keep: Path, jobs: int) -> list[str]:
    """Fill `out` with a JSON and a PNG for each trial; returns a line for each that could not be made."""
    missing = [trial for trial in todo if not (out / f"{trial.name}.json").exists()]
    with ThreadPoolExecutor(jobs) as workers:
        lines = workers.map(lambda trial: _run(trial, out, keep), missing)
        failures = []
        for count, (trial, line) in enumerate(zip(missing, lines, strict=True), 1):
            print(f"{count}/{len(missing)} {trial.name} {line}", file=sys.stderr, flush=True)
            if line:
                failures.append(f"{trial.name}: {line}")
    return failures


def _run(trial: Trial, out: Path, keep: Path) -> str:
    """Empty, or why it failed."""
    made = [out / f"{trial.name}.{kind}" for kind in ("json", "png")]
    files = ["--json", str(made[0]), "--plot", str(made[1]), "--keep", str(keep)]
    command = [sys.executable, "-P", "-m", "tools.evaluation", *trial.arguments, *files]
    path = os.pathsep.join([str(_CHECKOUT), *filter(None, [os.environ.get("PYTHONPATH")])])
    # One thread each: the jobs share the processors among them already.
    environment = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no reason given"])[-1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status 1 where any trial could not be made; the others are in the table all the same."""
    options = _parser().parse_args(arguments)
    try:
        todo = trials(yaml.safe_load(options.plan.read_text("utf-8")), options.teaching)
    except (OSError, yaml.YAMLError, PlanError) as error:
        print(f"evaluate-all: {options.plan}: {error}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    keep = options.keep or options.out / "taught"
    keep.mkdir(parents=True, exist_ok=True)
    failures = run_all(todo, options.out, keep, options.jobs)
    paths = [options.out / f"{trial.name}.json" for trial in todo]
    results = [json.loads(path.read_text("utf-8")) for path in paths if path.exists()]
    table = markdown(results)
    (options.out / "table.md").write_text(table + "\n", "utf-8")
    summaries = [{"meta": result["meta"], "summary": result["summary"]} for result in results]
    (options.out / "table.json").write_text(json.dumps(summaries, indent=1) + "\n", "utf-8")
    if results:
        from tools.evaluation.plots import draw_table  # noqa: PLC0415 - matplotlib takes a second to load

        draw_table(results, options.out / "table.png")
    print(table)
    print("\n".join(failures), file=sys.stderr)
    return 1 if failures else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evaluate-all", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("plan", type=Path, metavar="PLAN")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="for the results and the table")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="trials at a time")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="teaching drives and maps (default: FOLDER/taught)")
    parser.add_argument("--teaching", type=_seconds, default=(), metavar="S,S", help="teach for each of these instead")
    return parser


def _seconds(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no list of seconds such as 60,120,300") from None


if __name__ == "__main__":
    sys.exit(main())
