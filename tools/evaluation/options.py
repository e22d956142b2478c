"""The command line of tools/evaluate."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
from pathlib import Path

from tools.evaluation.axis import CALIBRATIONS, NONE, OWN
from tools.evaluation.experiments import AT_THE_DOCK
from tools.sim import teacher
from tools.sim.conditions import CONDITIONS, DISTURBED, LIGHTS, STANDING, expanded

# s: what the thesis drove (500 s for the SOM, 4000 s for the nodes); what a user is asked for.
TEACHING = {"default": 300.0, "thesis": 4500.0}
SPEED = {"default": teacher.SPEED, "thesis": 0.2}  # m/s


def parse(arguments: Sequence[str] | None, experiments: Collection[str]) -> argparse.Namespace:
    """Exits with status 2 and a sentence for what can't be run."""
    made = _parser(experiments)
    options = made.parse_args(arguments)
    if options.teach is None:
        options.teach = TEACHING[options.preset]
    if options.calibration is None:
        options.calibration = OWN if "tilt" in expanded(options.condition) else NONE
    if DISTURBED in options.condition and options.experiment not in AT_THE_DOCK:
        made.error(f"argument --condition: {DISTURBED!r} is for {' and '.join(AT_THE_DOCK)}")
    if options.experiment == "light" and any(name in LIGHTS for name in options.condition):
        made.error("argument --condition: the experiment `light` goes through all lights itself")
    return options


def _parser(experiments: Collection[str]) -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(prog="evaluate")
    made.add_argument("experiment", choices=list(experiments))
    made.add_argument("--world", required=True, metavar="MODULE:FACTORY", help="found on PYTHONPATH")
    made.add_argument("--runs", type=count, default=100, metavar="N")
    made.add_argument("--seed", type=int, default=1, metavar="S", help="of the world, the robot and the goals")
    made.add_argument("--preset", choices=list(TEACHING), default="default")
    made.add_argument(
        "--teach", type=_seconds, metavar="SECONDS", help="length of the teaching drive: 300, thesis: 4500"
    )
    made.add_argument(
        "--condition",
        type=conditions,
        default=(),
        metavar="NAME[,NAME]",
        help=f"{', '.join(CONDITIONS)}; {', '.join(STANDING)} hold while teaching, too, others after a dock was saved",
    )
    made.add_argument(
        "--calibration",
        choices=CALIBRATIONS,
        help="what it knows of a tilted camera: what its own `calibrate spin` finds (default), the truth, nothing",
    )
    made.add_argument(
        "--open", action="store_true", help="the dock is in the middle of the room, as in the thesis, not at its wall"
    )
    made.add_argument(
        "--homing", choices=["orb"], help="dock by the usual peer's estimates, ORB and RANSAC, instead of the preset's"
    )
    made.add_argument("--json", type=writable, required=True, metavar="OUT", help="file for the results")
    made.add_argument("--plot", type=writable, metavar="PNG", help="picture of the results")
    made.add_argument("--keep", type=_folder, metavar="DIR", help="teaching drives and maps, to be used again")
    return made


def count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 up")
    return int(text)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 10.0 <= seconds <= 7200.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds from 10 to 7200")
    return seconds


def conditions(text: str) -> tuple[str, ...]:
    names = tuple(name for name in text.split(",") if name != "nominal")
    unknown = [name for name in names if name not in CONDITIONS]
    if unknown:
        raise argparse.ArgumentTypeError(f"no condition {unknown[0]!r}; there are {', '.join(CONDITIONS)}")
    if len([name for name in expanded(names) if name in LIGHTS]) > 1:
        raise argparse.ArgumentTypeError(f"{text!r} holds more than one light")
    return names


def writable(text: str) -> Path:
    """Found out before the runs rather than after them."""
    path = Path(text)
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{path.parent} is no folder")
    return path


def _folder(text: str) -> Path:
    path = Path(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{path}: {error.strerror}") from error
    return path
