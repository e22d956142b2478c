"""tools/homing: how good single docking estimates are: the thesis' method, ours, and ORB + RANSAC on the same frames.

The evaluation of the thesis' §7.3.2: one target, 800 frames of a drive within 1.8 m of it, each frame by itself. The
snapshot is taken without the conditions that come and go, the frames are taken under them; what is mounted askew or
slopes does so for both, and the methods know the true tilt.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

import cv2

from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from omnibotd.perception import DEFAULT_CEILING
from tools.evaluation.docking import in_the_open
from tools.evaluation.homing import METHODS, METRIC, Errors, ask, drive, summary
from tools.evaluation.options import conditions, count, writable
from tools.sim.conditions import STANDING, Stage, expanded
from tools.sim.world_plugin import World, WorldError, load_world, relit_world

PARTS = 8  # of the drive, each under another of the lights, where these change, and with another smudged lens
THESIS = {"turn": "0.14 ± 8.46°, 8 of 800", "distance": "10.0 cm", "component": "0.9614"}  # its own robot's, §7.3.2


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints a table; exit status 1 where the world is none."""
    options = _parser().parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        world = load_world(options.world, options.seed)
        stage = _stage(options, world)
    except WorldError as error:
        print(f"homing: {error}", file=sys.stderr)
        return 1
    target = Pose2D(*world.dock) if options.at_dock else Pose2D(*in_the_open(world))
    errors = measured(stage, target, options.frames, options.seed, options.condition, _ceiling(options, world))
    found = {name: summary(some) for name, some in errors.items()}
    what = f"{options.world}, seed {options.seed}, {', '.join(options.condition) or 'nominal'}"
    print(_table(what, found))
    if options.json:
        meta = {key: str(value) for key, value in vars(options).items()}
        result = {"meta": meta, "methods": found, "frames": {name: _arrays(some) for name, some in errors.items()}}
        options.json.write_text(json.dumps(result) + "\n", "utf-8")
    if options.plot:
        from tools.evaluation.homing_plots import draw_homing  # noqa: PLC0415 - matplotlib takes a second to load

        draw_homing(errors, found, what, options.plot)
    return 0


def measured(
    stage: Stage, target: Pose2D, count: int, seed: int, conditions: Sequence[str], ceiling: float
) -> dict[str, Errors]:
    """What each method makes of the same frames."""
    stage.enter(())
    snapshot = _photograph(stage, target, 0.0)
    poses = drive(stage, target, count, seed)
    frames, part = [], len(poses) // PARTS + 1
    for number, pose in enumerate(poses):
        if number % part == 0:
            stage.enter(expanded(conditions, number // part), number)
        frames.append((pose, _photograph(stage, target @ pose, 1.0 + 0.4 * number)))
    return {name: _errors(name, stage.camera, snapshot, frames, ceiling) for name in METHODS}


def _errors(
    name: str, camera: CameraModel, snapshot: Frame, frames: Sequence[tuple[Pose2D, Frame]], ceiling: float
) -> Errors:
    print(f"{name}: {len(frames)} frames", file=sys.stderr, flush=True)
    return Errors.of(ask(METHODS[name](camera, snapshot, ceiling), frames), METRIC[name])


def _photograph(stage: Stage, pose: Pose2D, stamp: float) -> Frame:
    """As it comes from the camera, a JPEG."""
    return Frame(stamp, Frame(stamp, stage.render(pose.x, pose.y, pose.yaw, stamp)).jpeg())


def _stage(options: argparse.Namespace, world: World) -> Stage:
    standing = tuple(name for name in STANDING if name in expanded(options.condition))
    return Stage(world, partial(relit_world, options.world, options.seed), options.seed, standing)


def _ceiling(options: argparse.Namespace, world: World) -> float:
    """Metres above the camera: as told, or as the world's room says."""
    if options.ceiling is not None:
        return float(options.ceiling)
    room = getattr(world, "room", None)
    return DEFAULT_CEILING if room is None else float(room.rise)


def _table(what: str, found: dict[str, dict[str, Any]]) -> str:
    head = (
        "",
        "refused",
        "turn, mean ± sd, gross",
        "distance, sd",
        "component",
        "one estimate",
        "failed",
        "sure, wrong",
        "NEES, in 95 %",
    )
    lines = [f"{what}: single estimates", _row(head)]
    lines.append(_row(("thesis, its robot", "", THESIS["turn"], THESIS["distance"], THESIS["component"])))
    lines += [_row((name, *_cells(part))) for name, part in found.items()]
    return "\n".join(lines)


def _cells(part: dict[str, Any]) -> tuple[str, ...]:
    refused = f"{part['refused']} of {part['n']}"
    if "turn" not in part:
        return (refused,)
    turn, one = part["turn"], part["estimate_within_1_m"]
    return (
        refused,
        f"{turn['mean_deg']:.2f} ± {turn['sd_deg']:.2f}°, {turn['gross']} of {part['n'] - part['refused']}",
        f"{100 * part['distance']['sd_m']:.1f} cm",
        f"{part['component']['median']:.4f}",
        f"{100 * one['median_m']:.2f} cm, {one['median_deg']:.2f}°",
        f"{one['failed']:.1%}",
        f"{one['sure_and_wrong']}",
        "" if one["nees"] is None else f"{one['nees']['median']:.1f}, {one['nees']['within_95']:.0%}",
    )


def _row(cells: Sequence[str]) -> str:
    widths = (18, 14, 28, 14, 11, 18, 9, 13, 15)
    return "".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=False))


def _arrays(errors: Errors) -> dict[str, list[float]]:
    names = ("distance", "length", "turn", "component", "offset")
    return {name: [round(float(value), 5) for value in getattr(errors, name)] for name in names}


def _parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        prog="tools/homing", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("--world", required=True, metavar="MODULE:FACTORY", help="found on PYTHONPATH")
    made.add_argument("--seed", type=int, default=1, metavar="S", help="of the world and of the drive")
    made.add_argument("--frames", type=count, default=800, metavar="N")
    made.add_argument("--condition", type=conditions, default=(), metavar="NAME[,NAME]", help="as of tools/evaluate")
    made.add_argument("--at-dock", action="store_true", help="the target is the dock, not the middle of the room")
    made.add_argument("--ceiling", type=float, metavar="METRES", help="above the camera, where the world does not say")
    made.add_argument("--json", type=writable, metavar="OUT", help="file for the results, with all frames")
    made.add_argument("--plot", type=writable, metavar="PNG", help="picture like the thesis' figures 7.7 to 7.9")
    return made


if __name__ == "__main__":
    sys.exit(main())
