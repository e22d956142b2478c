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
# And from which a frame, blurred and smudged as it may be, is of a view's light: no other will tell more.
OWN_LIGHT = 0.75
# Tracked frames from one that is compared with another view to the next: a light lasts longer than that.
_COMPARE_EVERY = 3
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
    """The views of one dock. The one that served last is asked first, the others where the light is not its own."""

    def __init__(self, lights: Sequence[Light]) -> None:
        """At least one."""
        self._given = tuple(lights)
        self._lights = list(lights)
        self._tracked = 0  # frames in a light that is not the serving view's own

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """From nothing: the surest answer, and of those the best match."""
        answers = []
        for light in self._lights:
            answers.append((_in_dock(light.homing.fix(frame, odom_from_base), light), light))
            if _in_its_light(answers[-1][0]):
                break
        return self._best(answers)

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        """From `prior`, the dock_from_base expected. In a light that is not its own, the view that serves is compared
        with one of the others in turn, every third frame; where it has lost the dock, with all of them."""
        serving, *others = self._lights
        first = _track(serving, frame, odom_from_base, prior)
        if not others or _in_its_light(first):
            return first
        if first.verdict is not Verdict.REJECTED:
            self._tracked += 1
            turn, resting = divmod(self._tracked, _COMPARE_EVERY)
            if resting:
                return first
            others = [others[turn % len(others)]]
        found = [(_track(light, frame, odom_from_base, prior), light) for light in others]
        return self._best([(first, serving), *found])

    def _best(self, answers: Sequence[tuple[HomingEstimate, Light]]) -> HomingEstimate:
        """The view it comes from serves from now on."""
        best, light = max(answers, key=lambda answer: _worth(answer[0]))
        self._lights.remove(light)
        self._lights.insert(0, light)
        return best

    def each_of(self, frame: Frame, prior: Pose2D | None = None) -> list[HomingEstimate]:
        """What each view, in the order given at first, makes of a frame: from nothing, or from the pose expected."""
        if prior is not None:
            return [_track(light, frame, Pose2D(), prior) for light in self._given]
        return [_in_dock(light.homing.fix(frame, Pose2D()), light) for light in self._given]


def _track(light: Light, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
    expected = light.dock_from_view.inverse() @ prior
    return _in_dock(light.homing.track(frame, odom_from_base, expected), light)


def _in_dock(estimate: HomingEstimate, light: Light) -> HomingEstimate:
    pose = light.dock_from_view @ estimate.dock_from_base
    if estimate.covariance is None:
        return replace(estimate, dock_from_base=pose)
    c, s = math.cos(light.dock_from_view.yaw), math.sin(light.dock_from_view.yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return replace(estimate, dock_from_base=pose, covariance=turn @ estimate.covariance @ turn.T)


def _in_its_light(estimate: HomingEstimate) -> bool:
    return estimate.verdict is Verdict.ACCEPTED and estimate.score >= OWN_LIGHT


def _worth(estimate: HomingEstimate) -> tuple[int, float]:
    return _RANK[estimate.verdict], estimate.score
