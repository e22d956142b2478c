"""What a base did while it calibrated: its turns and its straight drives, from rest to rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

from omnibotd.core.calibration.looks import Look
from omnibotd.core.geometry import Twist2D, wrap
from omnibotd.core.kinematics import DifferentialDrive

# Steps smaller than this (rad, m) are the end of what went before: braking, a wheel that settles.
_TURN, _WAY = math.radians(2.0), 0.01


@dataclass(frozen=True, slots=True)
class Phase:
    """From look `first` to look `last`, both at rest: wheels turned by `left` and `right` (rad)."""

    turns: bool
    first: int
    last: int
    left: float
    right: float

    @property
    def rolled(self) -> float:
        """What both wheels turned together (rad), whichever way."""
        return abs(self.left) + abs(self.right)


def phases_of(looks: Sequence[Look], drive: DifferentialDrive) -> list[Phase]:
    """`drive` is what the looks' odometry was made with."""
    steps = [_step(before, now) for before, now in pairwise(looks)]
    kinds = _kinds(steps)
    phases = []
    for kind, members in groupby(range(len(steps)), key=kinds.__getitem__):
        if kind == 0:  # it stood
            continue
        own = list(members)
        angles = [drive.wheel_speeds(steps[i]) for i in own]
        left, right = sum(a[0] for a in angles), sum(a[1] for a in angles)
        phases.append(Phase(abs(kind) == 1, own[0], own[-1] + 1, left, right))
    return phases


def _step(before: Look, now: Look) -> Twist2D:
    """Metres along the arc and radians between two looks."""
    a, b = before.odom_from_base, now.odom_from_base
    yaw = wrap(b.yaw - a.yaw)
    heading = a.yaw + yaw / 2.0
    chord = (b.x - a.x) * math.cos(heading) + (b.y - a.y) * math.sin(heading)
    return Twist2D(chord if abs(yaw) < 1e-9 else chord * (yaw / 2.0) / math.sin(yaw / 2.0), yaw)


def _kinds(steps: Sequence[Twist2D]) -> list[int]:
    """Of each step: 1 or -1 a turn, 2 or -2 a drive, by its sign; 0 before anything moves."""
    kinds = [0]
    for step in steps:
        if abs(step.vx) > _WAY:
            kinds.append(2 if step.vx > 0.0 else -2)
        elif abs(step.wz) > _TURN:
            kinds.append(1 if step.wz > 0.0 else -1)
        else:
            kinds.append(kinds[-1])
    return kinds[1:]
