"""What counts when fixes and odometry disagree."""

from __future__ import annotations

import math

import numpy as np
import pytest

from omnibotd.core.docking.dock_filter import DockFilter
from omnibotd.core.geometry import Pose2D
from omnibotd.core.percept import HomingEstimate, Verdict

DOCK = Pose2D(1.0, 2.0, 0.5)  # odom_from_dock


def fix(base: Pose2D, sigma: float | None, odom: Pose2D | None = None, yaw_sigma: float = 0.002) -> HomingEstimate:
    """One that says the base stands at `base` in the dock's frame; by odometry it stands there, or at `odom`."""
    covariance = None if sigma is None else np.diag([sigma**2, sigma**2, yaw_sigma**2])
    where = DOCK @ base if odom is None else odom
    return HomingEstimate(
        stamp=0.0,
        odom_from_base=where,
        dock_from_base=base,
        score=0.5,
        margin=1.0,
        verdict=Verdict.ACCEPTED,
        covariance=covariance,
    )


def started(first: HomingEstimate) -> DockFilter:
    known = DockFilter(Pose2D(5.0, 5.0, 1.0), first.odom_from_base)
    known.update(first)
    return known


def base_at(known: DockFilter, odom: Pose2D) -> Pose2D:
    return known.dock_from_odom @ odom


def test_the_first_fix_counts_alone() -> None:
    known = started(fix(Pose2D(-0.3, 0.1, 0.2), 0.05))
    assert base_at(known, DOCK @ Pose2D(-0.3, 0.1, 0.2)).distance(Pose2D(-0.3, 0.1)) < 1e-6


def test_who_backed_out_of_the_dock_is_not_misled_by_fixes_from_afar() -> None:
    """They all err by 3 cm the same way, as in other light."""
    known = started(fix(Pose2D(), 0.003))
    for k in range(1, 41):
        there = Pose2D(-0.01 * k, 0.0, 0.0)
        known.update(fix(Pose2D(there.x, 0.03, 0.0), 0.02, DOCK @ there))
    assert base_at(known, DOCK).distance(Pose2D()) < 0.012


def test_a_little_vaguer_fixes_do_not_wear_down_what_is_known() -> None:
    """Eight centimetres back to mend what the dock itself showed, and looking there for a while."""
    known = started(fix(Pose2D(), 0.004))
    back = Pose2D(-0.08)
    for _ in range(30):
        known.update(fix(Pose2D(-0.088, -0.006), 0.005, DOCK @ back))
    assert base_at(known, DOCK @ back).distance(back) < 0.001


def test_what_is_seen_from_near_overrules_what_was_seen_from_afar() -> None:
    known = started(fix(Pose2D(-0.5, 0.04, 0.0), 0.03, DOCK @ Pose2D(-0.5)))
    for k in range(50):
        there = Pose2D(-0.5 + 0.01 * (k + 1), 0.0, 0.0)
        known.update(fix(there, 0.003 + 0.05 * abs(there.x)))
    assert base_at(known, DOCK).distance(Pose2D()) < 0.004


def test_standing_still_makes_it_no_surer_than_a_second_look() -> None:
    """A hundred fixes of one picture know what one knows: the one from nearer still counts."""
    known = started(fix(Pose2D(-0.3), 0.01))
    for _ in range(100):
        known.update(fix(Pose2D(-0.3), 0.01))
    known.update(fix(Pose2D(-0.3, 0.01), 0.002, DOCK @ Pose2D(-0.3)))
    assert base_at(known, DOCK @ Pose2D(-0.3)).y > 0.009


def test_wheels_that_spun_are_found_out() -> None:
    known = started(fix(Pose2D(-0.1), 0.003))
    spun = DOCK @ Pose2D(0.2)  # by odometry; it stands where it stood
    for _ in range(3):
        known.update(fix(Pose2D(-0.1), 0.003, spun))
    assert base_at(known, spun).distance(Pose2D(-0.1)) < 0.003


def test_a_turn_is_fused_the_short_way_round() -> None:
    known = started(fix(Pose2D(0.0, 0.0, math.pi - 0.001), 0.003))
    known.update(fix(Pose2D(0.0, 0.0, -math.pi + 0.001), 0.003, DOCK @ Pose2D(0.0, 0.0, math.pi - 0.001)))
    assert abs(base_at(known, DOCK @ Pose2D(0.0, 0.0, math.pi)).yaw) == pytest.approx(math.pi, abs=0.005)


def test_a_fix_that_does_not_say_how_sure_it_is_counts_alone() -> None:
    known = started(fix(Pose2D(), 0.003))
    known.update(fix(Pose2D(-0.2, 0.1, 0.3), None))
    assert base_at(known, DOCK @ Pose2D(-0.2, 0.1, 0.3)).distance(Pose2D(-0.2, 0.1)) < 1e-9
