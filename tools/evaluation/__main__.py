"""tools/evaluate EXPERIMENT --world MODULE:FACTORY: runs the whole daemon in virtual time, writes what came of it."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import cv2
import numpy as np

from omnibotd import __version__
from omnibotd.control_protocol import RpcError
from omnibotd.presets import PRESETS
from tools.evaluation import axis, carried, docking, experiments
from tools.evaluation.calibration import Calibration, Estimate
from tools.evaluation.course import Course, Plan
from tools.evaluation.docking import in_the_open
from tools.evaluation.experiments import Experiment
from tools.evaluation.lessons import Lesson, driven, taught_robot
from tools.evaluation.options import SPEED, parse
from tools.evaluation.orb_homing import OrbHoming
from tools.evaluation.route import route
from tools.evaluation.summary import Run, Summary, as_table, by_condition, recovery
from tools.sim import virtual_time
from tools.sim.conditions import STANDING, Stage, expanded
from tools.sim.teacher import NoWay
from tools.sim.virtual_robot import somewhere
from tools.sim.world_plugin import World, WorldError, load_world, relit_world

EXPERIMENTS: dict[str, Experiment] = {
    "goto": experiments.goto,
    "kidnap": carried.kidnap,
    "route": route,
    "outside": carried.outside,
    "light": experiments.light,
    "dock": docking.dock,
    "rested": docking.rested,
    "afar": docking.afar,
    "starts": experiments.starts,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status 1 where the experiment could not be made; runs that failed are results, not errors."""
    options = parse(arguments, EXPERIMENTS)
    cv2.setNumThreads(1)  # frames are small: threads cost more than they save, and would compete with other runs
    began = time.perf_counter()
    try:
        runs, estimates, meta = _evaluate(options)
    except (WorldError, NoWay, RpcError, axis.NotCalibrated) as error:
        print(f"evaluate: {error}", file=sys.stderr)
        return 1
    meta = _described(options) | meta | {"wall_s": time.perf_counter() - began}
    summary = overview(runs, estimates)
    if options.experiment in experiments.AT_THE_DOCK:
        summary["docking"] = docking.docking_summary(runs)
    result = {"meta": meta, "runs": [run.as_json() for run in runs], "summary": summary}
    options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    if options.plot:
        from tools.evaluation.plots import draw_runs  # noqa: PLC0415 - matplotlib takes a second to load

        draw_runs(result, options.plot)
    print(f"{options.experiment} in {options.world}, seed {options.seed}, preset {options.preset}")
    print(Summary.of(runs).table())
    print(as_table(_more(result["summary"])))
    return 0


def overview(runs: Sequence[Run], estimates: Sequence[Estimate]) -> dict[str, object]:
    """The contract's summary, and beside it what the experiment gives more: by condition, recovery, calibration."""
    summary: dict[str, object] = asdict(Summary.of(runs))
    if len({run.condition for run in runs}) > 1:
        summary["by_condition"] = by_condition(runs)
    if any(run.carried for run in runs):
        summary["recovery"] = recovery(runs)
    return summary | {"calibration": asdict(Calibration.of(estimates))}


def _evaluate(options: argparse.Namespace) -> tuple[list[Run], list[Estimate], dict[str, object]]:
    """Runs, the place estimates made meanwhile, and what there is to say of the teaching and the cost."""
    standing = tuple(name for name in STANDING if name in expanded(options.condition))
    world = _world(options, load_world(options.world, options.seed))
    stage = Stage(world, partial(_relit, options), options.seed, standing, in_the_open(world) if options.open else None)
    how = {"preset": options.preset, "seconds": options.teach, "speed": SPEED[options.preset], "standing": standing}
    how["axis"] = _axis(options, stage)
    lesson = experiments.lesson(options.experiment, stage, options.world, options.seed, **how)
    with ExitStack() as exits:
        if options.homing == "orb":
            peer = replace(PRESETS[options.preset], homing=OrbHoming)
            exits.enter_context(mock.patch.dict(PRESETS, {options.preset: peer}))
        keep = options.keep or Path(exits.enter_context(TemporaryDirectory(prefix="omnibot-")))
        folder, reused = driven(lesson, stage, keep)
        return virtual_time.run(_experiment(options, lesson, stage, folder, reused))


async def _experiment(
    options: argparse.Namespace, lesson: Lesson, stage: Stage, folder: Path, reused: tuple[str, ...]
) -> tuple[list[Run], list[Estimate], dict[str, object]]:
    plan = Plan(options.runs, options.seed, tuple(options.condition))
    async with taught_robot(lesson, stage, folder, reused) as taught:
        nodes, kept = len(taught.topo_map), ", ".join(taught.reused)
        _report(f"taught {nodes} nodes in {lesson.seconds:.0f} s" + (f" (kept: {kept})" if kept else ""))
        course = Course(taught, stage, lesson.area, plan, _report)
        course.enter()
        began = time.perf_counter()
        runs = await EXPERIMENTS[options.experiment](course)
        wall = time.perf_counter() - began
        frames, seconds = taught.robot.frames, taught.robot.seconds
        cost = {"frames": frames, "virtual_s": seconds}
        pace = {"frames_per_s": frames / wall, "real_time_factor": seconds / wall}
        taught_as = {"nodes": nodes, "reused": list(taught.reused), "bounds": list(stage.bounds)}
        if lesson.axis is not None:
            taught_as |= {"axis": asdict(lesson.axis), "true_axis": asdict(axis.known(stage))}
        return runs, course.estimates, {**taught_as, **cost, **pace}


def _axis(options: argparse.Namespace, stage: Stage) -> axis.Axis | None:
    """What the robot is told of its camera before it is taught."""
    if options.calibration == axis.NONE:
        return None
    if options.calibration == axis.KNOWN:
        return axis.known(stage)
    return virtual_time.run(axis.measured(stage, options.seed, somewhere(stage)))


def _world(options: argparse.Namespace, world: World) -> World:
    """For the thesis' method with the two tiles that it takes its heading from."""
    if options.preset != "thesis":
        return world
    from tools.sim.compass_tiles import with_compass_tiles  # noqa: PLC0415

    return with_compass_tiles(world)


def _relit(options: argparse.Namespace, light: str) -> World | None:
    world = relit_world(options.world, options.seed, light)
    return None if world is None else _world(options, world)


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _more(summary: dict[str, object]) -> dict[str, str]:
    """Rows for what the summary has beyond the contract."""
    calibration, again = summary["calibration"], summary.get("recovery")
    rows = {"expected calibration error": f"{calibration['error']:.3f}"}
    if "docking" in summary:
        rows |= _docked(summary["docking"])
    if again:
        rows["found itself again"] = f"{again['recovered']} of {again['n']}"
        rows["found itself after, median"] = "never" if again["median_s"] is None else f"{again['median_s']:.1f} s"
    parts = {} if "docking" in summary else summary.get("by_condition", {})
    for name, part in parts.items():
        rows[f"{name}: median, within 0.15 m"] = f"{100 * part['median_m']:.1f} cm, {part['within']['0.15']:.1%}"
    return rows


def _docked(summary: dict[str, Any]) -> dict[str, str]:
    rows = {f"docking, {name}": text for name, text in docking.figures(summary).items() if text}
    for condition, part in summary.get("by_condition", {}).items():
        shown = docking.figures(part)
        rows[f"{condition}: docked"] = f"{shown['docked']}, {shown['mean']}"
    return rows


def _described(options: argparse.Namespace) -> dict[str, object]:
    return {
        "experiment": options.experiment,
        "world": options.world,
        "seed": options.seed,
        "teach_s": options.teach,
        "preset": options.preset,
        "homing": options.homing,
        "open": options.open,
        "calibration": options.calibration,
        "conditions": list(options.condition),
        "omnibotd": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


if __name__ == "__main__":
    sys.exit(main())
