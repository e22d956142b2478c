"""Delayed initialisation that keeps several bearings of a landmark, over gaps of the view, until they fix it well."""

from __future__ import annotations

import math
from collections.abc import Hashable, Set
from dataclasses import dataclass
from itertools import chain

import numpy as np

from omnibotd.core.slam.bearing import of_points, wrapped
from omnibotd.core.slam.belief import Belief, Floats
from omnibotd.core.slam.sighting import Bearing, Waiting, freeze, release

# Bearings kept of one landmark (each costs a frozen pose in the state), how many it takes, and for how long (s) they
# are worth keeping: by then the frozen poses are known no better than the map would be.
KEPT, NEEDED, OLDEST = 8, 3, 120.0
# A bearing adds something where the robot has moved (m) and the direction has changed (rad), or moved far.
STEP, TURN, FAR_STEP = 0.05, math.radians(1.5), 0.3
# Good enough: this much parallax (rad), and a range known to a fifth.
PARALLAX, RELATIVE_RANGE = math.radians(8.0), 0.2
# Where landmarks can be (m), and a prior (m) so wide that it says nothing of where.
NEAREST, FARTHEST, ANYWHERE = 0.3, 12.0, 100.0
# Misfit beyond which bearings don't belong together: mean of chi^2 per degree of freedom, with room for few degrees.
MISFIT, MISFIT_SPREAD = 3.0, 3.0
_ROUNDS = 10


class SeveralBearings:
    """Bearings of a landmark wait in the belief until together they fix it; those that contradict each other go."""

    def __init__(self) -> None:
        self._waiting: dict[Hashable, list[Waiting]] = {}

    def sight(self, belief: Belief, bearing: Bearing, variance: float, stamp: float) -> bool:
        kept = [old for old in self._waiting.get(bearing.name, []) if stamp - old.pose.stamp <= OLDEST]
        self._waiting[bearing.name] = kept
        if kept and not _adds(belief, kept[-1], bearing.angle):
            return False
        kept.append(Waiting(bearing.angle, freeze(belief, stamp)))
        if len(kept) > KEPT:
            kept.pop(KEPT // 2)  # the ends carry the parallax
        return len(kept) >= NEEDED and self._try(belief, bearing.name, variance)

    def end_of_view(self, belief: Belief, seen: Set[Hashable], stamp: float) -> None:
        release(belief, chain.from_iterable(self._waiting.values()))

    def _try(self, belief: Belief, name: Hashable, variance: float) -> bool:
        kept = self._waiting[name]
        spans = [belief.span(waiting.pose) for waiting in kept]
        fix = _fix(belief, spans, np.array([waiting.angle for waiting in kept]), variance)
        if fix is None:
            return False
        if fix.contradictory:
            self._waiting[name] = kept[len(kept) // 2 :]
            return False
        if fix.relative_range > RELATIVE_RANGE:
            return False
        _insert(belief, name, fix, variance)
        del self._waiting[name]
        return True


@dataclass(frozen=True, slots=True)
class _Fix:
    """A landmark from k bearings: `point` (2,), misfits (k,), derivatives by the belief (k, n) and the point (k, 2)."""

    point: Floats
    misfits: Floats
    by_belief: Floats
    by_point: Floats
    contradictory: bool
    relative_range: float


def triangulated(poses: Floats, angles: Floats) -> Floats | None:
    """The point (2,) that bearings (k,) from poses (k, 3) mean; None without parallax, or where they can't agree."""
    rays = poses[:, 2] + angles
    if np.abs(wrapped(rays[:, None] - rays)).max() < PARALLAX:
        return None
    normals = np.stack([-np.sin(rays), np.cos(rays)], axis=1)
    point: Floats = np.linalg.lstsq(normals, (normals * poses[:, :2]).sum(1), rcond=None)[0]
    for _ in range(_ROUNDS):
        seen = of_points(poses, point[None])
        if not seen.valid.all():
            return None
        step = np.linalg.lstsq(seen.by_landmark, wrapped(angles - seen.bearings), rcond=None)[0]
        point = point + np.clip(step, -1.0, 1.0)
    ranges = np.hypot(*(point - poses[:, :2]).T)
    behind = np.abs(wrapped(angles - of_points(poses, point[None]).bearings)).max() > math.pi / 4
    return None if behind or ranges[-1] > FARTHEST or ranges.min() < NEAREST else point


def _adds(belief: Belief, last: Waiting, angle: float) -> bool:
    """Whether a bearing from here says more than the last one did."""
    pose, before = belief.pose, belief.mean[belief.span(last.pose)]
    moved = math.hypot(*(pose[:2] - before[:2]))
    turned = abs(math.remainder(pose[2] + angle - before[2] - last.angle, math.tau))
    return moved >= FAR_STEP or (moved >= STEP and turned >= TURN)


def _fix(belief: Belief, spans: list[slice], angles: Floats, variance: float) -> _Fix | None:
    """Least squares over the bearings, weighed with what is unknown of the poses they were taken from."""
    poses = np.array([belief.mean[span] for span in spans])
    point = triangulated(poses, angles)
    if point is None:
        return None
    seen = of_points(poses, point[None])
    by_belief = np.zeros((len(spans), len(belief.mean)))
    for row, span, by_pose in zip(by_belief, spans, seen.by_pose, strict=True):
        row[span] = by_pose
    misfits, by_point = wrapped(angles - seen.bearings), seen.by_landmark
    spread = by_belief @ belief.covariance @ by_belief.T + variance * np.eye(len(spans))
    scaled = np.linalg.solve(spread, by_point)
    weights = np.linalg.solve(by_point.T @ scaled, scaled.T)  # point = weights @ bearings, (2, k)
    left = misfits - by_point @ (weights @ misfits)
    freedom = len(spans) - 2
    limit = MISFIT * freedom + MISFIT_SPREAD * math.sqrt(2.0 * freedom)
    contradictory = bool(left @ np.linalg.solve(spread, left) > limit)
    by_newest = -weights @ by_belief
    by_newest[:, spans[-1].start : spans[-1].start + 2] -= np.eye(2)
    relative = by_newest @ belief.covariance @ by_newest.T + variance * weights @ weights.T
    away = point - poses[-1, :2]
    share = math.sqrt(away @ relative @ away) / float(away @ away)
    return _Fix(point, misfits, by_belief, by_point, contradictory, share)


def _insert(belief: Belief, name: Hashable, fix: _Fix, variance: float) -> None:
    """The landmark comes from anywhere, and all its bearings correct it and the poses they were taken from."""
    belief.append(name, fix.point, np.zeros((2, len(belief.mean))), ANYWHERE**2 * np.eye(2))
    jacobian = np.hstack([fix.by_belief, fix.by_point])
    belief.correct(jacobian, np.full(len(jacobian), variance), fix.misfits)
