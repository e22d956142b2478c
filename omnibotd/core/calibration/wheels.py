"""Radii and separation of the wheels from the ceiling: turns on the spot, and straight drives out and back.

A turn by sight against the wheels' own gives separation over radius; a drive's change of heading the ratio of the
wheels; its length in ceiling heights the radius over the height. The ceiling alone does not say how long a metre is:
its height must be known, or one distance measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import reduce

import numpy as np

from omnibotd.core.calibration.adjustment import Adjusted
from omnibotd.core.calibration.headings import seen_headings
from omnibotd.core.calibration.looks import Look
from omnibotd.core.calibration.panorama import Floats, Grid, Pictures
from omnibotd.core.calibration.phases import Phase, phases_of
from omnibotd.core.calibration.sightline import Way, ceiling_of, seen_way
from omnibotd.core.calibration.spin import follow, judged, turn_rates, wheel_headings
from omnibotd.core.calibration.turn import Turn
from omnibotd.core.calibration.wheel_fit import Seen, WheelFit, fitted
from omnibotd.core.geometry import Pose2D
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel

# Drives are measured well enough with a camera that is known so many times worse than a spin should know it.
_LENIENCE = 2.5
# Least that the wheels must have turned (rad) and driven (m).
_LEAST_TURNED, _LEAST_DRIVEN = 1.8 * 2.0 * math.pi, 2.0
# Looks that the camera is found from: one round (rad) of this many phases.
_ROUND, _ROUNDS = 1.1 * 2.0 * math.pi, 2
# How headings are followed all the way: pictures of half the size do.
_REDUCTION = 2
# Shares: the worst sigma worth having, and a change that no wheel needs. Errors over the usual ones that mean that
# something happened.
_WORST_SIGMA, _WILDEST, _WORST_RESIDUAL = 0.004, 0.25, 3.0
# With this much of the ceiling at another height to one of what most of it is at, nobody knows which is configured.
_LARGEST_STEP = 0.6
# Where all that is seen and most of it differ in height by this share, there are steps, and a tape is better;
# and what remains of the difference after allowing for it.
_STEPPED, _STEP_ERROR = 0.004, 0.6
# A tape's error (m).
_TAPE = 0.003


class Scale(StrEnum):
    """Where the length comes from that the ceiling alone can't tell."""

    CEILING = "ceiling_height"
    DISTANCE = "distance"
    NOMINAL = "nominal"


@dataclass(frozen=True, slots=True)
class WheelsResult:
    """Lengths in metres; sigmas are shares (0.001 = 0.1 %), without what the configured height is wrong by.

    `residual` is how much larger errors are than on a hard floor. `straight` is how far it stands at the end from where
    it began to drive. With `scale` NOMINAL the mean radius is still the one configured, and only ratio and separation
    over radius are measured. `verdict` is ACCEPTED or REJECTED; `sentence` says why, and what to do.
    """

    radius_left: float
    radius_right: float
    separation: float
    radius_sigma: float
    ratio_sigma: float
    separation_sigma: float
    residual: float
    scale: Scale
    turned: float
    driven: float
    straight: float
    verdict: Verdict
    sentence: str

    def with_distance(self, metres: float) -> WheelsResult:
        """The same with the length from a tape: so far it stands from where it began to drive."""
        factor = metres / self.straight
        scaled = replace(
            self,
            radius_left=self.radius_left * factor,
            radius_right=self.radius_right * factor,
            separation=self.separation * factor,
            radius_sigma=math.hypot(self.radius_sigma, _TAPE / metres),
            separation_sigma=math.hypot(self.separation_sigma, _TAPE / metres),
            scale=Scale.DISTANCE,
            driven=self.driven * factor,
            straight=metres,
        )
        if self.verdict is Verdict.REJECTED:
            return scaled
        if abs(factor - 1.0) > _WILDEST:
            sentence = (
                f"{metres:.3f} m measured, but {self.straight:.3f} m driven: measure from where it began to drive"
            )
            return replace(scaled, verdict=Verdict.REJECTED, sentence=sentence)
        return replace(scaled, sentence=_told(scaled))


def estimate(
    looks: Sequence[Look], camera: CameraModel, drive: DifferentialDrive, ceiling_height: float | None = None
) -> WheelsResult:
    """From the looks of `motions.BaseMotion`, whose odometry was made by `drive`; never raises for a bad run.

    `ceiling_height` metres from camera to ceiling. Raises FrameError where a frame is no picture or not of the
    camera's size.
    """
    phases = phases_of(looks, drive)
    turns, drives = [p for p in phases if p.turns], [p for p in phases if not p.turns]
    nothing = _nothing(drive, turns, drives)
    if nothing.turned < _LEAST_TURNED or nothing.driven < _LEAST_DRIVEN:
        turned = math.degrees(nothing.turned)
        return replace(nothing, sentence=f"turned {turned:.0f} degrees, drove {nothing.driven:.1f} m: let it finish")
    found, seen_turns, wheels_turned = _follow_turns(looks, camera, turns)
    spin = judged(found, wheels_turned, _LENIENCE)
    if spin.verdict is Verdict.REJECTED:
        return replace(nothing, sentence=spin.sentence)
    ways = [seen_way([look.frame for look in looks[p.first : p.last + 1]], found.turn.camera) for p in drives]
    known = [way.of_base(found.turn.offset) for way in ways if way is not None]
    if len(known) < len(ways):
        return replace(nothing, sentence="the ceiling was lost from sight; try in steady light where it shows more")
    return _measured(drive, seen_turns, list(zip(drives, known, strict=True)), ceiling_height)


def _nothing(drive: DifferentialDrive, turns: Sequence[Phase], drives: Sequence[Phase]) -> WheelsResult:
    """The wheels as they are configured, measured by nobody."""
    left, right = drive.radii
    turned = drive.wheel_radius * sum(p.rolled for p in turns) / drive.wheel_separation
    driven = drive.wheel_radius * sum(p.rolled for p in drives) / 2.0
    unknown = (1.0, 1.0, 1.0, 0.0)
    lengths = (left, right, drive.wheel_separation)
    return WheelsResult(*lengths, *unknown, Scale.NOMINAL, turned, driven, 0.0, Verdict.REJECTED, "")


def _follow_turns(
    looks: Sequence[Look], camera: CameraModel, turns: Sequence[Phase]
) -> tuple[Adjusted, list[Seen], float]:
    """The camera and the turns by sight; and how far the wheels went round from one side to the other."""
    first = turns[0].first
    own = looks[first : turns[-1].last + 1]
    rates, wheels = turn_rates(own), wheel_headings(own)
    small, grid = camera.reduced(_REDUCTION), Grid.of(camera)
    heading = seen_headings(small, grid, Pictures.of([look.frame for look in own], small, _REDUCTION), wheels)
    chosen = _chosen(turns, heading, first)
    pictures = Pictures.of([own[i].frame for i in chosen], camera)
    found = follow(Turn.start(camera, grid, heading[chosen], rates[chosen]), grid, pictures)
    exact = dict(zip(chosen, found.turn.heading, strict=True))
    seen = [Seen(p, float(exact[p.last - first] - exact[p.first - first]), 0.0) for p in turns]
    return found, seen, float(np.ptp(wheels))


def _chosen(turns: Sequence[Phase], heading: Floats, first: int) -> list[int]:
    """Looks that tell of the camera, and those between phases, by what they look at: neighbours see much the same."""
    ends = {i - first for p in turns for i in (p.first, p.last)}
    rounds = {
        i - first
        for p in turns[:_ROUNDS]
        for i in range(p.first, p.last)
        if abs(heading[i - first] - heading[p.first - first]) < _ROUND
    }
    return sorted(ends | rounds, key=lambda i: float(heading[i]) % (2.0 * math.pi))


def _measured(
    drive: DifferentialDrive, turns: list[Seen], drives: list[tuple[Phase, Way]], ceiling_height: float | None
) -> WheelsResult:
    """The wheels' lengths, and whether to believe them."""
    plane, other = ceiling_of(np.concatenate([way.patches for _, way in drives]))
    seen = turns + [Seen(phase, way.turned, way.length * (1.0 + plane)) for phase, way in drives]
    fit = fitted(seen, drive.wheel_radius)
    end = reduce(Pose2D.__matmul__, [way.end for _, way in drives])
    straight = math.hypot(end.x, end.y) * (1.0 + plane)
    if ceiling_height is not None and other < _LARGEST_STEP:
        result = _in_metres(fit, seen, straight, ceiling_height, Scale.CEILING, _STEP_ERROR * abs(plane))
    else:
        result = _in_metres(fit, seen, straight, drive.wheel_radius / fit.radius, Scale.NOMINAL, 0.0)
    fault = _fault(result, fit, drive)
    if fault:
        return replace(result, sentence=fault)
    stepped = ceiling_height is not None and (other >= _LARGEST_STEP or abs(plane) > _STEPPED)
    return replace(result, verdict=Verdict.ACCEPTED, sentence=_told(result, stepped))


def _in_metres(
    fit: WheelFit, seen: Sequence[Seen], straight: float, height: float, scale: Scale, height_sigma: float
) -> WheelsResult:
    """All lengths times the ceiling's height; not judged yet."""
    return WheelsResult(
        fit.left * height,
        fit.right * height,
        fit.separation * height,
        math.hypot(fit.radius_sigma, height_sigma),
        fit.ratio_sigma,
        math.hypot(fit.separation_sigma, height_sigma),
        fit.residual,
        scale,
        sum(abs(one.turned) for one in seen if one.phase.turns),
        sum(abs(one.driven) for one in seen) * height,
        straight * height,
        Verdict.REJECTED,
        "",
    )


def _fault(result: WheelsResult, fit: WheelFit, drive: DifferentialDrive) -> str:
    """Why this is not to be believed, and what to do; empty where it is."""
    if fit.residual > _WORST_RESIDUAL:
        return f"errors {fit.residual:.0f} times as large as usual: a wheel slipped, or it was pushed; run it again"
    worst = max(fit.radius_sigma, fit.ratio_sigma, fit.separation_sigma)
    if worst > _WORST_SIGMA:
        return f"known to {100.0 * worst:.1f} % only: run it again on a smooth hard floor"
    left, right = drive.radii
    for name, now, before in (
        ("left wheel's radius", result.radius_left, left),
        ("right wheel's radius", result.radius_right, right),
        ("wheels' separation", result.separation, drive.wheel_separation),
    ):
        if abs(now / before - 1.0) > _WILDEST:
            return f"the {name} came out as {now:.4f} m, configured is {before:.4f} m: check base.ticks_per_rev first"
    return ""


def _told(result: WheelsResult, stepped: bool = False) -> str:
    """The result in a sentence or two; `stepped`: the ceiling has several heights, and one is configured."""
    sentence = (
        f"radii {1000.0 * result.radius_left:.2f} and {1000.0 * result.radius_right:.2f} mm, "
        f"separation {1000.0 * result.separation:.1f} mm to {100.0 * result.separation_sigma:.2f} %"
    )
    several = "the ceiling has several heights, and nothing says which is configured"
    unset = "the ceiling alone does not tell how long a metre is, and docking.ceiling_height is not set"
    if result.scale is Scale.NOMINAL:
        sentence += f", if the mean radius is as configured: {several if stepped else unset}"
    elif stepped:
        sentence += f"; {several}"
    else:
        return sentence
    return (
        f"{sentence}. Measure with a tape how far it stands from where it began to drive (about "
        f"{result.straight:.2f} m), and run `calibrate base --distance METRES`"
    )
