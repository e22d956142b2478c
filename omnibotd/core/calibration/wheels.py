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
from omnibotd.core.calibration.there_and_back import tied
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
# something happened: of 40 runs in the reporting rooms one came to 1.7, with lengths off by 0.8 %, the others to 1.3 at
# most; the limit was chosen by them.
_WORST_SIGMA, _WILDEST, _WORST_RESIDUAL = 0.004, 0.25, 1.6
# A ceiling is as high as configured where it shows clearly that it is level: so much of what is seen lies at another
# height, to one of what lies at most of it; all of it and most of it differ in height by this share at most; one
# drive's length and the next's by this one. Tiles show 0.1, 0.0005 and 0.0001 of these; faint plaster with walls near
# by 0.4 and more, and lengths that are off by as much as a percent.
_LARGEST_STEP, _STEPPED, _DISAGREEING = 0.2, 0.0015, 0.0015
# Steps and beams bend a drive as it is seen, always to the same side, by up to half a degree: a share of the ratio.
_BENT = 0.002
# A tape's error (m).
_TAPE = 0.003
_LOST = (
    "the ceiling was not recognised all the way, or it did not come back to where it was; try a metre or more from "
    "walls, in steady light, where the ceiling shows more"
)


class Scale(StrEnum):
    """Where the length comes from that the ceiling alone can't tell."""

    CEILING = "ceiling_height"
    DISTANCE = "distance"
    NOMINAL = "nominal"


@dataclass(frozen=True, slots=True)
class WheelsResult:
    """Lengths in metres; sigmas are shares (0.001 = 0.1 %), without what the configured height is wrong by.

    `residual` is how much larger errors are than on a hard floor. `straight` is how far it stands at the end from where
    it began to drive. With `scale` NOMINAL the mean radius is still the one configured, and the sigmas are without what
    that is wrong by: only ratio and separation over radius are measured. `verdict` is ACCEPTED or REJECTED; `sentence`
    says why, and what to do.
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
        if self.verdict is Verdict.REJECTED:
            return self
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
        if abs(factor - 1.0) > _WILDEST:
            sentence = (
                f"{metres:.3f} m measured, but {self.straight:.3f} m driven: measure from where it began to drive"
            )
            return replace(scaled, verdict=Verdict.REJECTED, sentence=sentence)
        return replace(scaled, sentence=_lengths(scaled))


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
    ways = _ways(looks, drives, found.turn)
    if ways is None:
        return replace(nothing, sentence=_LOST)
    seen, agreed = ways
    based = [(phase, way.of_base(found.turn.offset)) for phase, way in zip(drives, agreed, strict=True)]
    result = _measured(drive, seen_turns, based, ceiling_height, level=_level(seen, agreed))
    return result if result.verdict is Verdict.REJECTED else replace(result, sentence=_told(result, ceiling_height))


def _ways(looks: Sequence[Look], drives: Sequence[Phase], turn: Turn) -> tuple[list[Way], list[Way]] | None:
    """The drives as they are seen one by one, and tied together; None where the ceiling was lost."""
    seen = []
    for phase in drives:
        way = seen_way([look.frame for look in looks[phase.first : phase.last + 1]], turn.camera)
        if way is None:
            return None
        seen.append(way)
    ends = [looks[drives[0].first].frame, *(looks[phase.last].frame for phase in drives)]
    agreed = tied(seen, ends, turn.camera)
    return None if agreed is None else (seen, agreed)


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


def _level(seen: Sequence[Way], agreed: Sequence[Way]) -> bool:
    """Whether the ceiling shows that it is of one height; `agreed` are the same ways, tied together."""
    plane, other = ceiling_of(np.concatenate([way.patches for way in seen]))
    spread = float(np.std([way.length / same.length for way, same in zip(seen, agreed, strict=True)]))
    return other < _LARGEST_STEP and abs(plane) < _STEPPED and spread < _DISAGREEING


def _measured(
    drive: DifferentialDrive,
    turns: list[Seen],
    drives: list[tuple[Phase, Way]],
    ceiling_height: float | None,
    *,
    level: bool,
) -> WheelsResult:
    """The wheels' lengths, and whether to believe them; the height counts where the ceiling is `level`."""
    seen = turns + [Seen(phase, way.turned, way.length) for phase, way in drives]
    fit = fitted(seen, drive.wheel_radius)
    end = reduce(Pose2D.__matmul__, [way.end for _, way in drives])
    scale = Scale.NOMINAL if ceiling_height is None or not level else Scale.CEILING
    height = drive.wheel_radius / fit.radius if ceiling_height is None or not level else ceiling_height
    uneven = _STEPPED if scale is Scale.CEILING else 0.0  # so much is tolerated
    result = WheelsResult(
        fit.left * height,
        fit.right * height,
        fit.separation * height,
        math.hypot(fit.radius_sigma, uneven),
        fit.ratio_sigma if level else math.hypot(fit.ratio_sigma, _BENT),
        math.hypot(fit.separation_sigma, uneven),
        fit.residual,
        scale,
        sum(abs(one.turned) for one in turns),
        sum(abs(one.driven) for one in seen) * height,
        math.hypot(end.x, end.y) * height,
        Verdict.REJECTED,
        "",
    )
    fault = _fault(result, fit, drive)
    return replace(result, sentence=fault) if fault else replace(result, verdict=Verdict.ACCEPTED)


def _fault(result: WheelsResult, fit: WheelFit, drive: DifferentialDrive) -> str:
    """Why this is not to be believed, and what to do; empty where it is."""
    if fit.residual > _WORST_RESIDUAL:
        return (
            f"errors {fit.residual:.1f} times as large as usual: a wheel slipped, or it was pushed; run it again, on a "
            "smooth hard floor"
        )
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


def _lengths(result: WheelsResult) -> str:
    return (
        f"radii {1000.0 * result.radius_left:.2f} and {1000.0 * result.radius_right:.2f} mm, "
        f"separation {1000.0 * result.separation:.1f} mm to {100.0 * result.separation_sigma:.2f} %"
    )


def _told(result: WheelsResult, ceiling_height: float | None) -> str:
    """The result in a sentence or two, what it rests on, and what would make it better."""
    if result.scale is Scale.CEILING and ceiling_height is not None:
        return (
            f"{_lengths(result)}, if the ceiling is {ceiling_height:.2f} m above the camera, as docking.ceiling_height "
            f"says: each centimetre that it is wrong by is {1.0 / ceiling_height:.1f} %"
        )
    why = (
        "the ceiling alone does not tell how long a metre is, and docking.ceiling_height is not set"
        if ceiling_height is None
        else "the ceiling does not show clearly that it is level, and docking.ceiling_height may be of another part"
    )
    return (
        f"{_lengths(result)}, if the mean radius is as configured: {why}. Measure with a tape how far it stands from "
        f"where it began to drive (about {result.straight:.2f} m), and run `calibrate base --distance METRES`"
    )
