"""A dock seen in several lights: every frame is registered with the view that fits it best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import DockView
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.frame import Frame

# Views of one dock: day, dusk and two kinds of lamps; each is a picture of 50 kB in the map's file.
MAX_VIEWS = 4
# Correlation from which two views are of one light: the later one takes the other's place.
SAME_LIGHT = 0.9
_RANK = {Verdict.REJECTED: 0, Verdict.AMBIGUOUS: 1, Verdict.ACCEPTED: 2}


class Homing(Protocol):
    """Says where the base stood when a frame was taken, relative to where one view was taken."""

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """From nothing. CoreError where the frame can't be used."""

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        """From the pose expected. CoreError where the frame can't be used."""


@dataclass(frozen=True, slots=True)
class Light:
    """What registers frames with one view, and where in the dock's frame the view was taken."""

    homing: Homing
    dock_from_view: Pose2D


def with_view(views: Sequence[DockView], view: DockView, likeness: Sequence[float]) -> tuple[DockView, ...]:
    """The views of a dock with another one, which is that much like each of them (correlation).

    It takes the place of one in the same light, the oldest of equals; of the most similar where there are too many.
    """
    alike = max(range(len(views)), key=lambda k: likeness[k])
    if likeness[alike] < SAME_LIGHT and len(views) < MAX_VIEWS:
        return (*views, view)
    same = next((k for k in range(len(views)) if likeness[k] >= SAME_LIGHT), alike)
    return (*(other for k, other in enumerate(views) if k != same), view)


class Lights:
    """The views of one dock. The one that served last is asked first, the others only where it is not sure."""

    def __init__(self, lights: Sequence[Light]) -> None:
        """At least one."""
        self._given = tuple(lights)
        self._lights = list(lights)

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """From nothing: the surest answer, and of those the best match."""
        answers = []
        for light in self._lights:
            answers.append((_in_dock(light.homing.fix(frame, odom_from_base), light), light))
            if answers[-1][0].verdict is Verdict.ACCEPTED:
                break
        best, light = max(answers, key=lambda answer: _worth(answer[0]))
        self._prefer(light)
        return best

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        """From `prior`, the dock_from_base expected; another view only where the one that serves has lost it."""
        first = self._track(self._lights[0], frame, odom_from_base, prior)
        if first.verdict is not Verdict.REJECTED:
            return first
        for light in self._lights[1:]:
            found = self._track(light, frame, odom_from_base, prior)
            if found.verdict is not Verdict.REJECTED:
                self._prefer(light)
                return found
        return first

    @staticmethod
    def _track(light: Light, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        expected = light.dock_from_view.inverse() @ prior
        return _in_dock(light.homing.track(frame, odom_from_base, expected), light)

    def each_of(self, frame: Frame) -> list[HomingEstimate]:
        """What each view, in the order given at first, makes of a frame."""
        return [_in_dock(light.homing.fix(frame, Pose2D()), light) for light in self._given]

    def _prefer(self, light: Light) -> None:
        self._lights.remove(light)
        self._lights.insert(0, light)


def _in_dock(estimate: HomingEstimate, light: Light) -> HomingEstimate:
    pose = light.dock_from_view @ estimate.dock_from_base
    if estimate.covariance is None:
        return replace(estimate, dock_from_base=pose)
    c, s = math.cos(light.dock_from_view.yaw), math.sin(light.dock_from_view.yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return replace(estimate, dock_from_base=pose, covariance=turn @ estimate.covariance @ turn.T)


def _worth(estimate: HomingEstimate) -> tuple[int, float]:
    return _RANK[estimate.verdict], estimate.score
