"""Ego-motion from the ceiling (the thesis' first suggestion, section 8.3): odometry with and without sight."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from omnibotd.core.compass.sighted_odometry import sight
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.reproduction.item import Check, Compared, Item, Outcome
from tools.sim import ceilings
from tools.sim.panorama import PanoramaError
from tools.sim.plant import Body
from tools.sim.teacher import SPEED, towards

Floats = NDArray[np.float64]

CEILINGS = ("tiles", "plain", "beams", "photo")
SEEDS = (41, 42)  # rooms and drives that nothing was tuned on
FRAMES, QUICK_FRAMES = 600, 12
PERIOD = 0.1  # s between frames
PIECE = 5.0  # m over which drift is told
LIMIT = 0.01  # of the distance
HEIGHT, HEIGHT_ERROR = 2.2, 0.3  # m, as the robot takes it where nobody measured, and how far that may be off (share)
_HALF = 2.0  # m: the square that is driven in
_REACHED = 0.15
_LENS = CameraModel.equidistant(640, 480, math.radians(190.0))


@dataclass(frozen=True, slots=True)
class Fault:
    """What more is wrong with the wheels: the size of left and right, and slip, as factors."""

    left: float = 1.0
    right: float = 1.0
    slip: float = 1.0


SOUND = Fault()
FAULTS = {
    "one wheel 10 % smaller": Fault(left=0.9),
    "both 10 % smaller": Fault(0.9, 0.9),
    "ten times the slip": Fault(slip=10.0),
}
FAULTY = ("tiles", "plain")  # ceilings under which faults are tried, on the first seed
# (heading, compass) as configured; the wheels alone are in every row.
WAYS = {
    "fused": ("fused", "tracker"),
    "compass": ("compass", "tracker"),
    "registration, compass": ("compass", "registration"),
    "Labrosse, compass": ("compass", "labrosse"),
    "Labrosse, fused": ("fused", "labrosse"),
}


@dataclass(frozen=True, slots=True)
class Drift:
    """Of one way of odometry on one drive: mean error over pieces of 5 m and at the end, as shares of the distance; the
    heading's error at the end (rad/s) and at its worst (rad)."""

    pieces: float
    end: float
    turning: float
    worst: float

    @classmethod
    def of(cls, estimated: Sequence[Pose2D], true: Sequence[Pose2D]) -> Drift:
        way = np.concatenate([[0.0], np.cumsum([a.distance(b) for a, b in pairwise(true)])])
        heading = [
            wrap((e.yaw - estimated[0].yaw) - (t.yaw - true[0].yaw)) for e, t in zip(estimated, true, strict=True)
        ]
        whole = _off(estimated, true, 0, len(true) - 1) / max(float(way[-1]), 1.0)
        starts = np.searchsorted(way, np.arange(0.0, float(way[-1]) - PIECE, PIECE / 2.0))
        ends = np.searchsorted(way, way[starts] + PIECE)
        pieces = [_off(estimated, true, i, j) / PIECE for i, j in zip(starts, ends, strict=True) if j < len(way)]
        seconds = PERIOD * (len(true) - 1)
        worst = float(np.abs(heading).max())
        return cls(float(np.mean(pieces)) if pieces else whole, whole, abs(heading[-1]) / seconds, worst)


def _off(estimated: Sequence[Pose2D], true: Sequence[Pose2D], start: int, end: int) -> float:
    """Metres between two ends of a piece that begins at the same pose."""
    moved, truly = (poses[start].inverse() @ poses[end] for poses in (estimated, true))
    return moved.distance(truly)


def wander(seed: int, frames: int) -> list[Pose2D]:
    """To random points of the square as a teacher drives, a frame each tenth of a second."""
    rng = np.random.default_rng((seed, 31))
    pose, goal = Pose2D(*rng.uniform(-_HALF, _HALF, 2), rng.uniform(-math.pi, math.pi)), Pose2D()
    poses = [pose]
    while len(poses) < frames:
        if pose.distance(goal) < _REACHED:
            goal = Pose2D(*rng.uniform(-_HALF, _HALF, 2))
        twist = towards(pose, (goal.x, goal.y), SPEED)
        turn, ahead = PERIOD * twist.wz, PERIOD * twist.vx
        pose = pose @ Pose2D(ahead * math.cos(turn / 2.0), ahead * math.sin(turn / 2.0), turn)
        poses.append(pose)
    return poses


def rolled(true: Sequence[Pose2D], seed: int, fault: Fault = SOUND) -> list[Pose2D]:
    """What the wheels of the simulated robot say of a drive: their sizes are wrong, and they slip."""
    rng, body = np.random.default_rng((seed, 32)), Body()
    both, difference = rng.standard_normal(2)
    sizes = 1.0 + body.scale_error * both + body.wheel_difference / 2.0 * difference * np.array([-1.0, 1.0])
    sizes *= (fault.left, fault.right)
    poses = [Pose2D()]
    for before, now in pairwise(true):
        step = before.inverse() @ now
        ahead, half = math.hypot(step.x, step.y), step.yaw * body.wheel_separation / 2.0
        wheels = np.array([ahead - half, ahead + half])
        left, right = (wheels + fault.slip * body.slip * np.sqrt(np.abs(wheels)) * rng.standard_normal(2)) / sizes
        turn, ahead = (right - left) / body.wheel_separation, (left + right) / 2.0
        poses.append(poses[-1] @ Pose2D(ahead * math.cos(turn / 2.0), ahead * math.sin(turn / 2.0), turn))
    return poses


@cache
def measured(quick: bool) -> dict[str, dict[str, list[Drift]]]:
    """Of each ceiling (and fault of the wheels) and way, one for each seed."""
    frames = QUICK_FRAMES if quick else FRAMES
    found: dict[str, dict[str, list[Drift]]] = {}
    for name in CEILINGS[:1] if quick else CEILINGS:
        try:
            drives = [_drive(name, seed, frames, SOUND) for seed in SEEDS[: 1 if quick else None]]
        except PanoramaError:
            continue
        found[name] = {way: [drive[way] for drive in drives] for way in drives[0]}
    for name in FAULTY[:1] if quick else FAULTY:
        for fault, wheels in FAULTS.items():
            found[f"{name}, {fault}"] = {way: [drift] for way, drift in _drive(name, SEEDS[0], frames, wheels).items()}
    return found


def _drive(name: str, seed: int, frames: int, fault: Fault) -> dict[str, Drift]:
    world, true = getattr(ceilings, name)(seed), wander(seed, frames)
    wheels = rolled(true, seed, fault)
    sights = {way: sight(*chosen, _LENS, HEIGHT, HEIGHT_ERROR) for way, chosen in WAYS.items()}
    poses: dict[str, list[Pose2D]] = {way: [] for way in WAYS}
    for number, (pose, by_wheels) in enumerate(zip(true, wheels, strict=True)):
        picture = world.render(pose.x, pose.y, pose.yaw, PERIOD * number)
        frame = Frame(PERIOD * number, np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8))
        for way, made in sights.items():
            poses[way].append(made.update(frame, by_wheels))
    return {"wheels": Drift.of(wheels, true)} | {way: Drift.of(each, true) for way, each in poses.items()}


def _run(quick: bool) -> Outcome:
    rows, checks = [], []
    for ceiling, ways in measured(quick).items():
        for way, drifts in ways.items():
            pieces, turning, worst = (
                float(np.mean([getattr(d, n) for d in drifts])) for n in ("pieces", "turning", "worst")
            )
            text = f"{pieces:.2%} of the way, {turning:.5f} rad/s, at worst {math.degrees(worst):.1f} degrees"
            rows.append(Compared(f"{ceiling}: {way}", "-", text))
        checks += _judged(ceiling, ways)
    numbers = {
        ceiling: {way: [[d.pieces, d.end, d.turning, d.worst] for d in drifts] for way, drifts in ways.items()}
        for ceiling, ways in measured(quick).items()
    }
    return Outcome(tuple(rows), tuple(checks), {"drifts": numbers})


def _judged(ceiling: str, ways: Mapping[str, Sequence[Drift]]) -> list[Check]:
    """Fused must be better than the wheels and than their lengths with a compass; good, where the wheels are sound."""
    fused, compass, wheels = (float(np.mean([d.pieces for d in ways[way]])) for way in ("fused", "compass", "wheels"))
    checks = [
        Check(f"{ceiling}: fused drifts less than the wheels", f"{fused:.2%} against {wheels:.2%}", fused < wheels),
        Check(
            f"{ceiling}: fused drifts less than the wheels with a compass",
            f"{fused:.2%} against {compass:.2%}",
            fused < compass,
        ),
    ]
    if ceiling not in CEILINGS:
        return checks
    good = Check(f"{ceiling}: sight and wheels drift <= 1 % of the distance", f"{fused:.2%}", fused <= LIMIT)
    return [good, *checks]


def _draw(data: Mapping[str, Any], figure: Figure) -> None:
    axes = figure.subplots()
    drifts = data["drifts"]
    ways = list(next(iter(drifts.values())))
    for place, way in enumerate(ways):
        at = np.arange(len(drifts)) + 0.14 * (place - len(ways) / 2.0)
        axes.bar(at, [100.0 * np.mean([d[0] for d in ceiling[way]]) for ceiling in drifts.values()], 0.13, label=way)
    axes.axhline(100.0 * LIMIT, color="black", lw=0.8, ls=":")
    axes.set(yscale="log", ylabel="error over 5 m (% of the way)")
    names = [name.replace(", ", ",\n", 1) for name in drifts]
    axes.set_xticks(range(len(drifts)), names, fontsize=6, rotation=40, ha="right")
    axes.legend(frameon=False, fontsize=7)


ITEM = Item(
    "odometry",
    "ego-motion from the ceiling (section 8.3, future work): odometry with and without sight",
    (
        "the thesis suggests it and does not try it; simulated robot, 0.3 m/s in 4 x 4 m, ten frames a second",
        "wheels wrong by 1 % in size and 0.2 % between the two (one standard deviation), and slipping at random; the "
        "ceiling's height is taken for 2.2 m to 30 %: how long a metre is say the wheels, so that wheels of a wrong "
        "size make a wrong metre with sight, too",
    ),
    _run,
    _draw,
)
