"""The thesis' second docking experiment (§7.3.2): single estimates on frames of a drive round a target, and truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from omnibotd.core.docking.registration import DockRegistration
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.thesis.docking import STEP, ThesisHoming
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.evaluation.orb_homing import OrbHoming
from tools.sim.world_plugin import World

FARTHEST = 1.8  # m from the target
NEAR = 1.0  # m: the range that the method is meant for
SPACING, TURN = 0.12, math.radians(15.0)  # between frames
CLEARANCE = 0.17  # m, the robot's radius
TRIES = 1000
# What is more than this off leads the robot astray: m and degrees.
WRONG_M, WRONG_DEG = 0.2, 10.0
GROSS = 30.0  # degrees beyond which a turn is a mistake by symmetry, not an inaccuracy
BIN = 0.2  # m, of the homing component by distance
TUNING = 4.685  # of the bisquare weights: MATLAB's robustfit

Floats = NDArray[np.float64]
MakeHoming = Callable[[CameraModel, Frame, float], Any]

METHODS: Mapping[str, MakeHoming] = {"thesis": ThesisHoming, "default": DockRegistration, "ORB": OrbHoming}
# The thesis' estimate is in pixels, and so is what it is worth in metres.
METRIC = {"thesis": False, "default": True, "ORB": True}


@dataclass(frozen=True, slots=True)
class Answer:
    """Where the base truly stood, in the target's frame, and what a method said."""

    truth: Pose2D
    said: HomingEstimate


def drive(world: World, target: Pose2D, count: int, seed: int) -> list[Pose2D]:
    """Poses in the target's frame, along straight ways from one random free point round it to the next."""
    rng = np.random.default_rng((seed, 73))

    def point() -> Pose2D:
        for _ in range(TRIES):
            away, bearing = FARTHEST * math.sqrt(rng.random()), rng.uniform(-math.pi, math.pi)
            pose = target @ Pose2D(away * math.cos(bearing), away * math.sin(bearing))
            if world.free(pose.x, pose.y, CLEARANCE):
                return Pose2D(pose.x, pose.y)
        raise ValueError(f"no free floor within {FARTHEST} m of {target}")

    pose, goal, poses = point(), point(), []
    while len(poses) < count:
        if target.distance(pose) <= FARTHEST and world.free(pose.x, pose.y, CLEARANCE):
            poses.append(target.inverse() @ pose)
        while pose.distance(goal) < 2.0 * SPACING:
            goal = point()
        off = pose.bearing(goal)
        turn = max(-TURN, min(TURN, off))
        ahead = SPACING if abs(off) < 0.5 else 0.0
        pose = pose @ Pose2D(ahead * math.cos(turn / 2), ahead * math.sin(turn / 2), turn)
    return poses


def ask(method: Any, frames: Sequence[tuple[Pose2D, Frame]]) -> list[Answer]:
    """Each frame by itself, from nothing."""
    return [Answer(truth, method.fix(frame, Pose2D())) for truth, frame in frames]


@dataclass(frozen=True)
class Errors:
    """Arrays (n,) over the frames that were not refused: true distance (m), estimated distance (m, or px where not
    metric), error of the turn (degrees), homing component (NaN where a vector has no length), error of the position
    (m), whether said to be sure, squared error over the covariance said (NaN where none is; 2.4 in the median where it
    is honest). Of the frames that were refused the number counts, in all and within a metre.
    """

    distance: Floats
    length: Floats
    turn: Floats
    component: Floats
    offset: Floats
    sure: NDArray[np.bool_]
    surprise: Floats
    refused: int
    refused_near: int

    @classmethod
    def of(cls, answers: Sequence[Answer], metric: bool) -> Errors:
        given = [answer for answer in answers if answer.said.verdict is not Verdict.REJECTED]
        truth = np.array([_vector(answer.truth.inverse()) for answer in given]).reshape(-1, 3)
        said = np.array([_vector(answer.said.dock_from_base.inverse()) for answer in given]).reshape(-1, 3)
        distance, length = np.hypot(*truth[:, :2].T), np.hypot(*said[:, :2].T)
        both = distance * length
        dot = (truth[:, :2] * said[:, :2]).sum(1)
        component = np.divide(dot, both, out=np.full(len(given), np.nan), where=both > 1e-9)
        scale = 1.0 if metric else _through_origin(distance, length)
        offset = np.hypot(*(said[:, :2] / scale - truth[:, :2]).T)
        turn = np.degrees([wrap(angle) for angle in said[:, 2] - truth[:, 2]])
        sure = np.array([answer.said.verdict is Verdict.ACCEPTED for answer in given], bool)
        lengths = length if metric else length / STEP
        refused = [math.hypot(a.truth.x, a.truth.y) for a in answers if a.said.verdict is Verdict.REJECTED]
        refused_near = sum(away <= NEAR for away in refused)
        surprise = np.array([_surprise(answer) for answer in given], float)
        return cls(distance, lengths, turn, component, offset, sure, surprise, len(refused), refused_near)

    @property
    def wrong(self) -> NDArray[np.bool_]:
        return (self.offset > WRONG_M) | (np.abs(self.turn) > WRONG_DEG)


def robust_line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope and intercept by iteratively reweighted least squares with bisquare weights (MATLAB's robustfit)."""
    design = np.column_stack([x, np.ones_like(x)])
    weights = np.ones_like(x)
    line = np.zeros(2)
    leverage = np.clip(np.einsum("ij,ij->i", design @ np.linalg.pinv(design.T @ design), design), 0.0, 0.9999)
    for _ in range(50):
        root = np.sqrt(weights)
        before, (line, *_) = line, np.linalg.lstsq(design * root[:, None], y * root, rcond=None)
        if np.allclose(before, line, rtol=1e-6, atol=1e-9):
            break
        residual = (y - design @ line) / np.sqrt(1.0 - leverage)
        scale = max(float(np.median(np.sort(np.abs(residual))[1:])) / 0.6745, 1e-9)
        weights = np.clip(1.0 - (residual / (TUNING * scale)) ** 2, 0.0, None) ** 2
    return float(line[0]), float(line[1])


def summary(errors: Errors) -> dict[str, Any]:
    """The thesis' figures, and what one estimate within a metre is worth to a robot."""
    n = len(errors.distance) + errors.refused
    if len(errors.distance) < 10:
        return {"n": n, "refused": errors.refused}
    near = errors.distance <= NEAR
    slope, intercept = robust_line(errors.distance[near], errors.length[near])
    off = (errors.length[near] - intercept) / slope - errors.distance[near]
    gross = np.abs(errors.turn) > GROSS
    defined = np.isfinite(errors.component)
    return {
        "n": n,
        "refused": errors.refused,
        "turn": {
            "gross": int(gross.sum()),
            "mean_deg": _mean(errors.turn[~gross]),
            "sd_deg": _sd(errors.turn[~gross]),
            "median_abs_deg": float(np.median(np.abs(errors.turn))),
            **_correlation(errors.distance, np.abs(errors.turn)),
        },
        "distance": {"slope": slope, "intercept": intercept, "mean_m": _mean(off), "sd_m": _sd(off)},
        "component": {
            "median": float(np.median(errors.component[defined])),
            "median_near": float(np.median(errors.component[defined & near])),
            "positive": float((errors.component[defined] > 0.0).mean()),
            "undefined": int((~defined).sum()),
            "by_distance": _by_distance(errors.distance[defined], errors.component[defined]),
            **_correlation(errors.distance[defined], errors.component[defined]),
        },
        "estimate_within_1_m": {
            "median_m": float(np.median(errors.offset[near])),
            "median_deg": float(np.median(np.abs(errors.turn[near]))),
            "failed": float(errors.wrong[near].sum() + errors.refused_near) / float(near.sum() + errors.refused_near),
            "sure_and_wrong": int((errors.wrong & errors.sure & near).sum()),
            "nees": _nees(errors.surprise[near & errors.sure & ~errors.wrong]),
        },
    }


def _surprise(answer: Answer) -> float:
    """Normalised estimation error squared (NEES), of three degrees of freedom."""
    if answer.said.covariance is None:
        return math.nan
    said, truth = answer.said.dock_from_base, answer.truth
    error = np.array([said.x - truth.x, said.y - truth.y, wrap(said.yaw - truth.yaw)])
    return float(error @ np.linalg.solve(answer.said.covariance, error))


def _nees(surprise: Floats) -> dict[str, float] | None:
    """Median, and the share within what 95 % should be within; None where no covariance was said."""
    known = surprise[np.isfinite(surprise)]
    if not len(known):
        return None
    return {"median": float(np.median(known)), "within_95": float((known <= stats.chi2.ppf(0.95, 3)).mean())}


def _vector(pose: Pose2D) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


def _through_origin(distance: Floats, length: Floats) -> float:
    """How many metres too long a metre is said to be."""
    near = (distance <= NEAR) & (distance > 0.1)
    return float(np.median(length[near] / distance[near])) if near.any() else 1.0


def _by_distance(distance: Floats, component: Floats) -> list[dict[str, float]]:
    bins = (distance / BIN).astype(int)
    return [
        {"from_m": BIN * k, "median": float(np.median(component[bins == k])), "n": int((bins == k).sum())}
        for k in range(round(FARTHEST / BIN))
        if (bins == k).any()
    ]


def _correlation(x: Floats, y: Floats) -> dict[str, float | bool]:
    """Spearman's rank correlation, and whether it is significant at 5 %; none where one of both is constant."""
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return {"spearman": 0.0, "significant": False}
    found = stats.spearmanr(x, y)
    return {"spearman": float(found.statistic), "significant": bool(found.pvalue < 0.05)}


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else math.nan


def _sd(values: Floats) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else math.nan
