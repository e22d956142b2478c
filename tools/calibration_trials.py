"""How well `calibrate spin` and `calibrate base` do: recovered against true (launcher: tools/calibration-trials).

Each trial is a simulated robot with a tilted camera, off the middle of the axle, whose optical centre is not where the
configuration has it, on wheels that are 5 % from what is configured and slip. The motions are the product's own. A run
of `calibrate base` counts twice: with lengths by the ceiling's height, and by a tape as `--distance` does.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omnibotd.core.calibration import spin, wheels
from omnibotd.core.calibration.looks import Look, Looks
from omnibotd.core.calibration.motions import LEG, BaseMotion, CalibrationMotion, SpinMotion
from omnibotd.core.calibration.phases import phases_of
from omnibotd.core.decision import Observation, Outcome
from omnibotd.core.geometry import Pose2D
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.odometry import WheelOdometry
from omnibotd.core.percept import Verdict
from omnibotd.core.safety import Limits, SafetyGate
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image
from tools.sim.plant import Body, SimulatedRobot
from tools.sim.room import Room, Surfaces
from tools.sim.world import World
from tools.sim.world_plugin import WorldError, load_world

LIMITS = Limits(0.3, 1.0, 0.5, 2.0)  # the configuration's defaults
STEP, STEPS_PER_TICK = 0.02, 5  # s of the body; ten ticks and frames a second
EXPOSURE_TO_ARRIVAL = 0.03  # s
CLEAR = 1.0  # m from walls at least, as users are told
LONGEST = 300.0  # s that a motion may take
BODY = Body(scale_error=0.0, wheel_difference=0.0)  # true dimensions; slip as usual
WHEELS_WRONG, RATIO_WRONG = 0.05, 0.02  # shares
TILT, CENTRE, OFFSET = (1.0, 2.0), (3.0, 10.0), (0.0, 0.03)  # degrees, px, m: least and most
BANDS = 12  # of a picture that is read row by row
TRACE = 32  # steps of the body that a picture may be read during: half a second
WORLDS = tuple(f"tools.sim.ceilings:{name}" for name in ("tiles", "beams", "photo", "hall", "plain"))
MAX_ERRORS = {"tilt_deg": 0.15, "centre_px": 0.5, "shape_percent": 0.5, "wheels_percent": 0.5}


def bare(seed: int) -> World:
    """A room of one grey: nothing to see, which a calibration must say."""
    grey = np.full((600, 600, 3), 150, np.uint8)
    return World(Surfaces(grey, grey[:200]), seed, room=Room())


@dataclass(frozen=True, slots=True)
class Mounting:
    """What the configuration does not know: true lens, and where (m) the camera stands in the base's axes."""

    camera: CameraModel
    offset: Pose2D

    @classmethod
    def drawn(cls, nominal: CameraModel, rng: np.random.Generator) -> Mounting:
        tilt, centre, offset = (_vector(rng, *bounds) for bounds in (TILT, CENTRE, OFFSET))
        tilted = (math.radians(tilt[0]), math.radians(tilt[1]))
        camera = replace(nominal, cx=nominal.cx + centre[0], cy=nominal.cy + centre[1], tilt=tilted)
        return cls(camera, Pose2D(*offset))


class TiltedCamera:
    """Pictures of a world through another mounting, and row by row where it has a rolling shutter."""

    def __init__(self, world: World, nominal: CameraModel, mounting: Mounting, readout: float) -> None:
        """`readout` (s) from the first row of a picture to its last."""
        true = mounting.camera
        v, u = np.mgrid[0 : true.height, 0 : true.width]
        rays = np.nan_to_num(true.unproject(np.stack([u, v], -1)), nan=-1.0)
        places = np.nan_to_num(nominal.project(rays), nan=-9.0).astype(np.float32)
        self._columns, self._rows = places[..., 0].copy(), places[..., 1].copy()
        self._world, self._offset, self._readout = world, mounting.offset, readout
        self._noise = np.random.default_rng(world.seed)

    def picture(self, stamp: float, trace: Sequence[tuple[float, Pose2D]]) -> bytes:
        """JPEG of the exposure that began at `stamp`; `trace` has the robot's poses from then on."""
        bands = BANDS if self._readout else 1
        image = np.vstack([self._band(stamp, trace, band, bands) for band in range(bands)])
        # Warping smooths the sensor's noise: this makes up for it.
        noisy = np.clip(image + self._noise.normal(0.0, 1.0, image.shape[:2])[..., None], 0, 255).astype(np.uint8)
        return bytes(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 90])[1])

    def _band(self, stamp: float, trace: Sequence[tuple[float, Pose2D]], band: int, bands: int) -> Image:
        read = stamp + self._readout * (band + 0.5) / bands
        eye = _pose_at(trace, read) @ self._offset
        whole = self._world.render(eye.x, eye.y, eye.yaw, stamp)
        rows = slice(*(round(len(self._rows) * edge / bands) for edge in (band, band + 1)))
        return np.asarray(cv2.remap(whole, self._columns[rows], self._rows[rows], cv2.INTER_LINEAR), np.uint8)


@dataclass(frozen=True, slots=True)
class Run:
    """A motion made: its looks, how it ended, and where the robot truly was at each look."""

    looks: tuple[Look, ...]
    poses: tuple[Pose2D, ...]
    outcome: Outcome
    seconds: float


def run(
    world: World, start: Pose2D, seed: int, camera: TiltedCamera, drive: DifferentialDrive, motion: CalibrationMotion
) -> Run:
    """Drive a robot through the motion, as the daemon would; only the pictures that are kept are taken."""
    plant = SimulatedRobot(world, (start.x, start.y, start.yaw), seed, BODY)
    odometry, gate, looks = WheelOdometry(drive), SafetyGate(LIMITS), Looks()
    trace: deque[tuple[float, Pose2D]] = deque(maxlen=TRACE)
    poses: list[Pose2D] = []
    exposures: list[tuple[float, list[tuple[float, Pose2D]]]] = []
    ticks, target, exposed = [0, 0], (0.0, 0.0), 0.0
    for n in range(round(LONGEST / STEP)):
        now = n * STEP
        trace.append((now, Pose2D(*plant.pose)))
        if n % STEPS_PER_TICK == 0:
            seen = Observation(now, odometry.odom_from_base)
            decision = motion.step(seen)
            if decision.outcome is not None:
                return Run(_developed(looks.kept, exposures, camera), tuple(poses), decision.outcome, now)
            twist = gate.limit(decision.twist, seen, STEP * STEPS_PER_TICK)
            left, right = (speed * BODY.ticks_per_rev / (2.0 * math.pi) for speed in drive.wheel_speeds(twist))
            target = (left, right)
            exposed = now
        for i, new in enumerate(plant.step(STEP, *target)):
            ticks[i] += new
        odometry.update(now + STEP, ticks[0], ticks[1], BODY.ticks_per_rev)
        if (n + 1) % STEPS_PER_TICK == 0:
            stamp, before = exposed + EXPOSURE_TO_ARRIVAL, len(looks.kept)
            looks.take(Frame(stamp, b""), odometry.at(stamp))
            if len(looks.kept) > before:
                exposures.append((exposed, list(trace)))
                poses.append(_pose_at(trace, exposed))
    raise RuntimeError(f"{type(motion).__name__} did not end within {LONGEST:.0f} s")


def _developed(
    kept: Sequence[Look], exposures: Sequence[tuple[float, list[tuple[float, Pose2D]]]], camera: TiltedCamera
) -> tuple[Look, ...]:
    """The looks with their pictures."""
    return tuple(
        replace(look, frame=replace(look.frame, data=camera.picture(*exposure)))
        for look, exposure in zip(kept, exposures, strict=True)
    )


@dataclass(frozen=True, slots=True)
class Trial:
    """One robot in one room."""

    world: str
    seed: int
    readout: float

    def spin(self) -> dict[str, Any]:
        """Errors of centre (px) and tilt (degrees) beside their sigmas."""
        world, nominal, mounting, rng = self._set_up()
        camera = TiltedCamera(world, nominal, mounting, self.readout)
        drive = self._configured(rng)
        made = run(world, _start(world, rng, 0.0, CLEAR), self.seed, camera, drive, SpinMotion(LIMITS))
        began = time.process_time()
        result = spin.estimate(made.looks, nominal)
        tilt = [a - b for a, b in zip(result.tilt, mounting.camera.tilt, strict=True)]
        centre = result.centre[0] - mounting.camera.cx, result.centre[1] - mounting.camera.cy
        return {
            **self._told("spin", result.verdict, result.sentence, time.process_time() - began),
            "centre_px": math.hypot(*centre),
            "centre_sigma_px": result.centre_sigma,
            "tilt_deg": math.degrees(math.hypot(*tilt)),
            "tilt_sigma_deg": math.degrees(result.tilt_sigma),
            "residual_px": result.residual,
            "sigmas": max(math.hypot(*centre) / result.centre_sigma, math.hypot(*tilt) / result.tilt_sigma),
        }

    def base(self) -> list[dict[str, Any]]:
        """Errors (%): by the ceiling's height, then by a tape."""
        world, nominal, mounting, rng = self._set_up()
        camera = TiltedCamera(world, nominal, mounting, self.readout)
        drive = self._configured(rng)
        made = run(world, _start(world, rng, LEG * 1.25, CLEAR), self.seed, camera, drive, BaseMotion(LIMITS))
        began = time.process_time()
        result = wheels.estimate(made.looks, nominal, drive, world.room.rise)
        seconds = time.process_time() - began
        drives_from = next(p.first for p in phases_of(made.looks, drive) if not p.turns)
        by_tape = made.poses[drives_from].distance(made.poses[-1])
        results = {"base by height": result, "base by tape": result.with_distance(by_tape)}
        return [{**self._told(what, r.verdict, r.sentence, seconds), **_wheel_errors(r)} for what, r in results.items()]

    def _set_up(self) -> tuple[World, CameraModel, Mounting, np.random.Generator]:
        world = load_world(self.world, self.seed)
        assert isinstance(world, World), "the trials need the lens and the height of a simulated room"
        lens = world.lens
        middle = ((lens.width - 1) / 2.0 + lens.offset[0], (lens.height - 1) / 2.0 + lens.offset[1])
        nominal = CameraModel.equidistant(lens.width, lens.height, math.radians(lens.fov_deg), lens.radius, middle)
        rng = np.random.default_rng((self.seed, 7901))
        return world, nominal, Mounting.drawn(nominal, rng), rng

    @staticmethod
    def _configured(rng: np.random.Generator) -> DifferentialDrive:
        """Wheels 5 % wrong, and unequal where they are equal in truth."""
        radius, separation = (1.0 + WHEELS_WRONG * rng.choice([-1.0, 1.0]) for _ in range(2))
        ratio = 1.0 + RATIO_WRONG * rng.uniform(-1.0, 1.0)
        return DifferentialDrive(BODY.wheel_radius * radius, BODY.wheel_separation * separation, ratio)

    def _told(self, what: str, verdict: Verdict, sentence: str, seconds: float) -> dict[str, Any]:
        return {**asdict(self), "what": what, "verdict": str(verdict), "sentence": sentence, "cpu_s": round(seconds, 1)}


def _wheel_errors(result: wheels.WheelsResult) -> dict[str, Any]:
    """`shape_percent` is the worse error of ratio and separation over radius; where no more than these is claimed,
    there is no `wheels_percent`, the worst of all lengths."""
    left, right, separation = (
        100.0 * math.log(found / true)
        for found, true in (
            (result.radius_left, BODY.wheel_radius),
            (result.radius_right, BODY.wheel_radius),
            (result.separation, BODY.wheel_separation),
        )
    )
    radius, ratio = (left + right) / 2.0, left - right
    errors = {
        "scale": str(result.scale),
        "shape_percent": max(abs(ratio), abs(separation - radius)),
        "sigmas": abs(ratio) / (100.0 * result.ratio_sigma),
        "residual": result.residual,
    }
    if result.scale is wheels.Scale.NOMINAL:
        return errors
    shares = (abs(radius) / result.radius_sigma, abs(separation) / result.separation_sigma)
    return {
        **errors,
        "wheels_percent": max(abs(left), abs(right), abs(separation)),
        "radius_sigma_percent": 100.0 * result.radius_sigma,
        "separation_sigma_percent": 100.0 * result.separation_sigma,
        "sigmas": max(errors["sigmas"], *(share / 100.0 for share in shares)),
    }


def _start(world: World, rng: np.random.Generator, ahead: float, clear: float) -> Pose2D:
    """Somewhere in the room, `clear` m from walls now and wherever it drives `ahead` m, give or take 20 degrees."""
    xmin, ymin, xmax, ymax = world.bounds
    for _ in range(10_000):
        pose = Pose2D(float(rng.uniform(xmin, xmax)), float(rng.uniform(ymin, ymax)), float(rng.uniform(-3.1, 3.1)))
        ends = [pose.transform(ahead * math.cos(a), ahead * math.sin(a)) for a in (-0.35, 0.0, 0.35)]
        if all(world.free(x, y, clear) for x, y in [(pose.x, pose.y), *ends]):
            return pose
    raise WorldError(f"no {ahead:.1f} m free ahead anywhere in {world.bounds}")


def _pose_at(trace: Sequence[tuple[float, Pose2D]], stamp: float) -> Pose2D:
    times, poses = [time for time, _ in trace], [pose for _, pose in trace]
    after = min(max(int(np.searchsorted(times, stamp)), 1), len(times) - 1)
    share = min(max((stamp - times[after - 1]) / STEP, 0.0), 1.0)
    step = poses[after - 1].inverse() @ poses[after]
    return poses[after - 1] @ Pose2D(share * step.x, share * step.y, share * step.yaw)


def _vector(rng: np.random.Generator, least: float, most: float) -> tuple[float, float]:
    length, toward = rng.uniform(least, most), rng.uniform(-math.pi, math.pi)
    return float(length * math.cos(toward)), float(length * math.sin(toward))


def _trials(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for world in options.worlds:
        for seed in range(options.first_seed, options.first_seed + max(options.spins, options.bases)):
            trial, k = Trial(world, seed, options.readout), seed - options.first_seed
            if k < options.spins:
                yield trial.spin()
            if k < options.bases:
                yield from trial.base()


def _summaries(results: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A line for each kind and world: accepted, and of those the mean and the worst error."""
    order = sorted(results, key=lambda r: (r["what"], r["world"]))
    for (what, world), group in groupby(order, key=lambda r: (r["what"], r["world"])):
        each = list(group)
        good = [r for r in each if r["verdict"] == Verdict.ACCEPTED]
        partly = sum(r.get("scale") == wheels.Scale.NOMINAL for r in good)
        asks = f" ({partly} ask for a tape)" if partly else ""
        errors = [
            f"{name} {np.mean(values):.3f} (worst {np.max(values):.3f}{limit})"
            for name, limit in ({k: f", wanted {most}" for k, most in MAX_ERRORS.items()} | {"sigmas": ""}).items()
            if (values := [r[name] for r in good if name in r])
        ]
        yield f"{what:14} {world:28} accepted {len(good)} of {len(each)}{asks}; " + ", ".join(errors)


def main(arguments: list[str] | None = None) -> int:
    """Exit status 1 where an accepted result is worse than it should be."""
    parser = argparse.ArgumentParser(prog="calibration-trials", description=__doc__)
    parser.add_argument("--worlds", nargs="+", default=WORLDS, metavar="MODULE:FACTORY")
    parser.add_argument("--spins", type=int, default=4, metavar="N", help="for each world")
    parser.add_argument("--bases", type=int, default=2, metavar="N", help="for each world")
    parser.add_argument("--first-seed", type=int, default=1, metavar="N")
    parser.add_argument("--readout", type=float, default=0.0, metavar="S", help="of a rolling shutter, top to bottom")
    parser.add_argument("--out", type=Path, metavar="FILE", help="all results as JSON")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    results = []
    for result in _trials(options):
        results.append(result)
        numbers = "  ".join(f"{k} {v:.3f}" for k, v in result.items() if isinstance(v, float) and k != "readout")
        print(f"{result['what']:14} {result['world']} {result['seed']}  {result['verdict']}  {numbers}", flush=True)
    if options.out:
        options.out.write_text(json.dumps(results, indent=1), "utf-8")
    print(*_summaries(results), sep="\n")
    accepted = [r for r in results if r["verdict"] == Verdict.ACCEPTED]
    return int(any(r.get(name, 0.0) > most for r in accepted for name, most in MAX_ERRORS.items()))


if __name__ == "__main__":
    sys.exit(main())
