"""tools/evaluate goto|dock --world MODULE:FACTORY: runs the whole daemon in virtual time and writes what came of it."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from omnibotd import __version__
from omnibotd.control_protocol import RpcError
from tools.evaluation.experiments import EXPERIMENTS, Plan
from tools.evaluation.summary import Run, Summary
from tools.sim import virtual_time
from tools.sim.teacher import NoWay
from tools.sim.virtual_robot import virtual_robot
from tools.sim.world_plugin import World, WorldError, load_world


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status 1 where the experiment could not be made; runs that failed are results, not errors."""
    options = _parser().parse_args(arguments)
    cv2.setNumThreads(1)  # frames are small: threads cost more than they save, and would compete with other runs
    began = time.perf_counter()
    try:
        world = load_world(options.world, options.seed)
        runs, cost = virtual_time.run(_evaluate(world, options))
    except (WorldError, NoWay, RpcError) as error:
        print(f"evaluate: {error}", file=sys.stderr)
        return 1
    wall = time.perf_counter() - began
    summary = Summary.of(runs)
    meta = _described(options) | cost | _pace(cost, wall)
    result = {"meta": meta, "runs": [run.as_json() for run in runs], "summary": asdict(summary)}
    options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    print(f"{options.experiment} in {options.world}, seed {options.seed}, preset {options.preset}")
    print(summary.table())
    print(f"{meta['frames_per_s']:.0f} frames/s, {meta['real_time_factor']:.1f} times real time", file=sys.stderr)
    return 0


async def _evaluate(world: World, options: argparse.Namespace) -> tuple[list[Run], dict[str, float]]:
    """The runs, and how many frames and virtual seconds they took, teaching included."""
    plan = Plan(options.runs, options.seed, options.teach)
    async with virtual_robot(world, options.seed) as robot:
        runs = await EXPERIMENTS[options.experiment](robot, plan, _report)
        return runs, {"frames": robot.frames, "virtual_s": robot.seconds}


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _pace(cost: dict[str, float], wall: float) -> dict[str, float]:
    return {
        "wall_s": wall,
        "frames_per_s": cost["frames"] / wall,
        "real_time_factor": cost["virtual_s"] / wall,
    }


def _described(options: argparse.Namespace) -> dict[str, object]:
    return {
        "experiment": options.experiment,
        "world": options.world,
        "seed": options.seed,
        "teach_s": options.teach,
        "preset": options.preset,
        "omnibotd": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="evaluate", description=__doc__)
    parser.add_argument("experiment", choices=EXPERIMENTS)
    parser.add_argument("--world", required=True, metavar="MODULE:FACTORY", help="found on PYTHONPATH")
    parser.add_argument("--runs", type=_count, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the world, the robot and the goals")
    parser.add_argument("--teach", type=_seconds, default=300.0, metavar="SECONDS", help="length of the teaching drive")
    parser.add_argument("--preset", choices=("default",), default="default")
    parser.add_argument("--json", type=_writable, required=True, metavar="OUT", help="file for the results")
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 up")
    return int(text)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 10.0 <= seconds <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds from 10 to 3600")
    return seconds


def _writable(text: str) -> Path:
    """Found out before the runs rather than after them."""
    path = Path(text)
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{path.parent} is no folder")
    return path


if __name__ == "__main__":
    sys.exit(main())
