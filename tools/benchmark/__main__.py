"""tools/bench: what a cycle costs and how that grows with the map, what training and docking take, beside peers.

One thread, one run, everything in turn, so that the ratios are fair; times are the thread's own processor time.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omnibotd import __version__
from tools.benchmark import cycle, decoding, docking, quota, rooms, scale, slow_pc, som_training
from tools.benchmark.report import as_text

PARTS = ("cycle", "scale", "som", "docking", "decoding")
EPILOG = """\
Maps are made of rendered rooms of a tuning seed; those of more than 4000 nodes are as many rooms side by side, at the
thesis' density of 250 nodes a square metre (100,000 nodes: 25 rooms).

Instructions, which no other load disturbs, by running one stage 0 and 20 times under valgrind, and the difference:
  for n in 0 20; do PYTHONHASHSEED=0 valgrind --tool=callgrind --callgrind-out-file=/dev/null python -c "
  from tools.benchmark import rooms; from omnibotd.core.vision.frame import Frame
  frame = Frame(0.0, rooms.jpegs(rooms.waypoints(1, 0.03, 11), 0.1)[0])
  for _ in range($n): frame.grey()" 2>&1 | grep Collected; done"""


@dataclass(frozen=True, slots=True)
class Sizes:
    """How much is measured: nodes of the cycle's map, frames and rounds, maps to grow over, samples and epochs."""

    nodes: int = 4000
    frames: int = 100
    rounds: int = 7
    grown: tuple[int, ...] = (1000, 4000, 20_000, 100_000)
    per_room: int = rooms.FULLEST
    perceptions: int = 600
    samples: int = 1000
    epochs: int = som_training.EPOCHS


FULL = Sizes()
QUICK = Sizes(800, 30, 2, (200, 400, 1600), 400, 150, 300, 3)


def run(sizes: Sizes, parts: Sequence[str]) -> dict[str, Any]:
    """Measure these parts; times in ms but where a name says otherwise."""
    cv2.setNumThreads(1)
    result: dict[str, Any] = {"meta": _described()}
    if "cycle" in parts:
        result["cycle"] = cycle.measure(sizes.nodes, sizes.frames, sizes.rounds, sizes.perceptions)
    if "scale" in parts:
        rounds = max(1, sizes.rounds // 2)
        result["scale"] = scale.measure(sizes.grown, sizes.per_room, sizes.frames, rounds, sizes.perceptions)
    if "som" in parts:
        result["som"] = som_training.measure(sizes.samples, sizes.epochs)
    if "docking" in parts:
        result["docking"] = docking.measure(sizes.frames, sizes.rounds)
    if "decoding" in parts:
        result["decoding"] = decoding.measure(sizes.nodes, sizes.frames)
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints tables."""
    options = _parse(arguments)
    cv2.setNumThreads(1)
    try:
        result = _on_a_slow_pc(options) if options.quota else run(QUICK if options.quick else FULL, options.only)
    except quota.QuotaError as error:
        print(f"tools/bench: {error}", file=sys.stderr)
        return 1
    print(as_text(result))
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    if options.plot and not options.quota:
        from tools.benchmark.plots import draw  # noqa: PLC0415 - matplotlib takes a second to load

        draw(result, options.plot)
    return 0


def _on_a_slow_pc(options: argparse.Namespace) -> dict[str, Any]:
    return {"meta": _described(), "quota": slow_pc.measure(options.minutes, options.keep)}


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="tools/bench", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="small sizes, for seeing that it works: seconds, not minutes"
    )
    parser.add_argument("--only", type=_parts, default=PARTS, metavar="PART,...", help=f"of {', '.join(PARTS)}")
    parser.add_argument(
        "--quota", action="store_true", help="the daemon in a processor quota of the Atom N270 class; root"
    )
    parser.add_argument("--minutes", type=float, default=4.0, metavar="M", help="with --quota: of driving and docking")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="with --quota: the map, made once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all figures")
    parser.add_argument("--plot", type=Path, metavar="PNG", help="picture of the results")
    return parser.parse_args(arguments)


def _parts(text: str) -> tuple[str, ...]:
    wanted = tuple(text.split(","))
    unknown = [part for part in wanted if part not in PARTS]
    if unknown:
        raise argparse.ArgumentTypeError(f"no part {unknown[0]!r}; parts: {', '.join(PARTS)}")
    return wanted


def _described() -> dict[str, str]:
    return {
        "omnibotd": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "processor": _processor(),
    }


def _processor() -> str:
    """As Linux calls it; the figures mean little without."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


if __name__ == "__main__":
    sys.exit(main())
