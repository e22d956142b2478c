"""Docks with several views: which one answers, and which one goes when another comes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from omnibotd.core.docking.lights import Light, Lights, with_view
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import DockView
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.frame import Frame

FRAME = Frame(1.0, b"")
HERE = Pose2D(-0.4, 0.1, 0.2)


@dataclass
class Eye:
    """Answers with this verdict and score, as if the base stood at HERE in the frame of its own view."""

    verdict: Verdict
    score: float
    dock_from_view: Pose2D = field(default_factory=Pose2D)
    asked: list[Pose2D | None] = field(default_factory=list)
    covariance: np.ndarray | None = None

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        return self._answer(odom_from_base, None)

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        return self._answer(odom_from_base, prior)

    def _answer(self, odom: Pose2D, prior: Pose2D | None) -> HomingEstimate:
        self.asked.append(prior)
        pose = self.dock_from_view.inverse() @ HERE
        return HomingEstimate(1.0, odom, pose, self.score, 0.2, self.verdict, self.covariance)


def lights(*eyes: Eye) -> Lights:
    return Lights([Light(eye, eye.dock_from_view) for eye in eyes])


def test_the_surest_answer_counts_then_the_best_match() -> None:
    unsure, wrong, better = Eye(Verdict.AMBIGUOUS, 0.4), Eye(Verdict.REJECTED, 0.9), Eye(Verdict.AMBIGUOUS, 0.5)
    assert lights(unsure, wrong, better).fix(FRAME, Pose2D()).score == 0.5
    assert lights(wrong, unsure).fix(FRAME, Pose2D()).verdict is Verdict.AMBIGUOUS


def test_a_sure_view_spares_the_others_and_is_asked_first_from_then_on() -> None:
    day, night = Eye(Verdict.REJECTED, 0.2), Eye(Verdict.ACCEPTED, 0.8)
    both = lights(day, night)
    both.fix(FRAME, Pose2D())
    both.fix(FRAME, Pose2D())
    assert (len(day.asked), len(night.asked)) == (1, 2)


def test_poses_are_the_docks_whichever_view_answers() -> None:
    moved = Pose2D(0.01, -0.02, 0.1)
    both = lights(Eye(Verdict.REJECTED, 0.2), Eye(Verdict.ACCEPTED, 0.8, moved))
    for answer in (both.fix(FRAME, Pose2D()), both.track(FRAME, Pose2D(), HERE)):
        found = answer.dock_from_base
        assert (found.x, found.y, found.yaw) == pytest.approx((HERE.x, HERE.y, HERE.yaw))


def test_what_is_unsure_ahead_of_a_turned_view_is_unsure_across_for_the_dock() -> None:
    spread = np.diag([0.04, 0.01, 0.09])
    eye = Eye(Verdict.ACCEPTED, 0.8, Pose2D(0.01, -0.02, math.pi / 2.0), covariance=spread)
    found = lights(eye).fix(FRAME, Pose2D()).covariance
    assert found == pytest.approx(np.diag([0.01, 0.04, 0.09]))


def test_the_view_of_this_light_counts_before_one_that_is_sure_all_the_same() -> None:
    day, night = Eye(Verdict.ACCEPTED, 0.5), Eye(Verdict.ACCEPTED, 0.8)
    assert lights(day, night).fix(FRAME, Pose2D()).score == 0.8


def test_tracking_finds_the_view_of_this_light_while_another_serves() -> None:
    """Two at most a frame, and on average not much more than one: three views would take three times as long."""
    day, dusk, night = Eye(Verdict.ACCEPTED, 0.5), Eye(Verdict.ACCEPTED, 0.45), Eye(Verdict.ACCEPTED, 0.8)
    several = lights(day, dusk, night)
    scores, looks = [], [0]
    for _ in range(9):
        scores.append(several.track(FRAME, Pose2D(), HERE).score)
        looks.append(len(day.asked) + len(dusk.asked) + len(night.asked))
    assert scores == sorted(scores) and scores[-1] == 0.8
    assert max(np.diff(looks)) == 2 and looks[-1] <= 9 + 3
    before = len(day.asked), len(dusk.asked)
    several.track(FRAME, Pose2D(), HERE)
    assert (len(day.asked), len(dusk.asked)) == before


def test_tracking_stays_with_its_view_until_that_has_lost_it() -> None:
    moved = Pose2D(0.01, -0.02, 0.1)
    first, second = Eye(Verdict.ACCEPTED, 0.8), Eye(Verdict.ACCEPTED, 0.9, moved)
    both = lights(first, second)
    both.track(FRAME, Pose2D(), HERE)
    assert (len(first.asked), len(second.asked)) == (1, 0)
    first.verdict = Verdict.REJECTED
    assert both.track(FRAME, Pose2D(), HERE).score == 0.9
    expected = moved.inverse() @ HERE
    assert second.asked[-1] is not None
    assert second.asked[-1].distance(expected) < 1e-9
    both.track(FRAME, Pose2D(), HERE)
    assert (len(first.asked), len(second.asked)) == (2, 2)


def test_each_view_is_asked_in_the_order_given() -> None:
    both = lights(Eye(Verdict.REJECTED, 0.2), Eye(Verdict.ACCEPTED, 0.8))
    both.fix(FRAME, Pose2D())
    assert [answer.score for answer in both.each_of(FRAME)] == [0.2, 0.8]


VIEWS = tuple(DockView(bytes([k])) for k in range(4))
NEW = DockView(b"new", Pose2D(0.001, 0.0, 0.0))


@pytest.mark.parametrize(
    ("count", "likeness", "kept"),
    [
        (1, [0.5], [0]),
        (1, [0.95], []),
        (3, [0.2, 0.93, 0.4], [0, 2]),
        (3, [0.2, 0.93, 0.97], [0, 2]),  # the oldest of those in this light
        (4, [0.2, 0.6, 0.4, 0.3], [0, 2, 3]),  # full: the most similar
    ],
)
def test_another_view_joins_or_replaces(count: int, likeness: list[float], kept: list[int]) -> None:
    assert with_view(VIEWS[:count], NEW, likeness) == (*(VIEWS[k] for k in kept), NEW)
