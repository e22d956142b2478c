"""The motions by which a robot calibrates itself, driven on ideal wheels; and which pictures are kept on the way."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from omnibotd.core.calibration.looks import CAPACITY, Look, Looks
from omnibotd.core.calibration.motions import LEG, TURN_RATE, BaseMotion, CalibrationMotion, SpinMotion, State
from omnibotd.core.calibration.phases import phases_of
from omnibotd.core.decision import Decision, Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.safety import Limits, SafetyGate
from omnibotd.core.vision.frame import Frame

LIMITS = Limits(0.3, 1.0, 0.5, 2.0)
TICK = 0.1
ANY_FRAME = Frame(0.0, np.zeros((2, 2), np.uint8))
DRIVE = DifferentialDrive(0.03, 0.2)

DANGERS = {
    ErrorName.EMERGENCY_STOP: {"emergency_stop": True},
    ErrorName.BASE_LINK_DOWN: {"base_ok": False},
    ErrorName.CAMERA_DOWN: {"camera_ok": False},
    ErrorName.BLOCKED: {"bumper_left": True},
}


def lived(motion: CalibrationMotion, seconds: float = 200.0) -> Iterator[tuple[Observation, Decision]]:
    """Every tick of a robot that does exactly what the gate lets through, to the motion's end."""
    gate, pose = SafetyGate(LIMITS), Pose2D()
    for tick in range(round(seconds / TICK)):
        seen = Observation(tick * TICK, pose)
        decision = motion.step(seen)
        yield seen, decision
        if decision.outcome is not None:
            return
        twist = gate.limit(decision.twist, seen, TICK)
        pose = pose @ DRIVE.displacement(*(TICK * speed for speed in DRIVE.wheel_speeds(twist)))
    pytest.fail(f"no end within {seconds} s")


def turned(ticks: list[tuple[Observation, Decision]]) -> np.ndarray:
    return np.unwrap([seen.odom_from_base.yaw for seen, _ in ticks])


def test_spin_turns_more_than_once_each_way_and_ends_where_it_began():
    ticks = list(lived(SpinMotion(LIMITS)))
    yaw = turned(ticks)
    assert ticks[-1][1].outcome is not None
    assert ticks[-1][1].outcome.error is None
    assert yaw.max() > 1.1 * 2.0 * math.pi
    assert yaw.min() > -0.1
    assert abs(yaw[-1]) < 0.1
    assert all(decision.twist.vx == 0.0 and abs(decision.twist.wz) <= TURN_RATE for _, decision in ticks)


def test_base_turns_three_times_each_way_and_ends_one_leg_ahead():
    ticks = list(lived(BaseMotion(LIMITS)))
    assert turned(ticks).max() == pytest.approx(3 * 2.0 * math.pi, abs=0.1)
    end = ticks[-1][0].odom_from_base
    assert math.hypot(end.x, end.y) == pytest.approx(LEG, abs=0.03)
    assert max(math.hypot(seen.odom_from_base.x, seen.odom_from_base.y) for seen, _ in ticks) < LEG + 0.1


@pytest.mark.parametrize("motion", [SpinMotion(LIMITS), BaseMotion(LIMITS)])
def test_progress_grows_to_one(motion):
    shares = [motion.progress for _ in lived(motion)]
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert all(now >= before - 0.01 for before, now in pairwise(shares))


def test_slow_base_gets_no_more_than_it_can_do():
    slow = replace(LIMITS, max_linear_velocity=0.1, max_angular_velocity=0.2)
    twists = [decision.twist for _, decision in lived(BaseMotion(slow), 400.0)]
    assert max(abs(t.vx) for t in twists) == pytest.approx(0.1)
    assert max(abs(t.wz) for t in twists) == pytest.approx(0.2)


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("error", DANGERS)
def test_every_danger_ends_it_in_every_state(state, error):
    motion = BaseMotion(LIMITS)
    seen = next(seen for seen, decision in lived(motion) if decision.state == state)
    after = motion.step(replace(seen, **DANGERS[error]))
    assert after.outcome is not None
    assert after.outcome.error is error
    assert motion.step(seen) == after
    assert after.twist == STOP


@pytest.mark.parametrize("where", [{"cliff": True}, {"bumper_right": True}, {"wheel_drop": True}])
def test_what_is_in_the_way_blocks(where):
    motion = SpinMotion(LIMITS)
    outcome = motion.step(replace(Observation(0.0, Pose2D()), **where)).outcome
    assert outcome is not None
    assert outcome.error is ErrorName.BLOCKED


def test_wheels_that_do_not_turn_end_it():
    motion = SpinMotion(LIMITS)
    outcomes = [motion.step(Observation(tick * TICK, Pose2D())).outcome for tick in range(80)]
    ended = next(i for i, outcome in enumerate(outcomes) if outcome is not None)
    assert 5.0 < ended * TICK < 7.0
    assert outcomes[ended].error is ErrorName.BLOCKED


def test_looks_keep_what_moved_enough_and_what_came_to_rest():
    looks = Looks()
    yaws = [0.0, 0.0, 0.05, 0.10, 0.15, 0.20, 0.22, 0.22, 0.22]
    for yaw in yaws:
        looks.take(ANY_FRAME, Pose2D(0.0, 0.0, yaw))
    assert [look.odom_from_base.yaw for look in looks.kept] == [0.0, 0.15, 0.22]


def test_looks_keep_by_way_too():
    looks = Looks()
    for step in range(11):
        looks.take(ANY_FRAME, Pose2D(0.02 * step, 0.0, 0.0))
    assert [round(look.odom_from_base.x, 2) for look in looks.kept] == [0.0, 0.06, 0.12, 0.18]


def test_looks_are_bounded():
    looks = Looks()
    for step in range(CAPACITY + 50):
        looks.take(ANY_FRAME, Pose2D(float(step), 0.0, 0.0))
    assert len(looks.kept) == CAPACITY


def test_phases_are_the_moves_with_what_the_wheels_turned():
    looks = Looks()
    for seen, _ in lived(BaseMotion(LIMITS)):
        looks.take(ANY_FRAME, seen.odom_from_base)
    phases = phases_of(looks.kept, DRIVE)
    assert [phase.turns for phase in phases] == [True] * 2 + [False] * 11
    assert all(now.first == before.last for before, now in pairwise(phases))
    for phase, sign in zip(phases[:2], (1.0, -1.0), strict=True):
        rolled = sign * 3 * 2.0 * math.pi * 0.1 / 0.03
        assert (phase.left, phase.right) == pytest.approx((-rolled, rolled), rel=0.01)
    for phase, sign in zip(phases[2:], (1.0, -1.0) * 6, strict=False):
        assert (phase.left, phase.right) == pytest.approx((sign * LEG / 0.03,) * 2, rel=0.02)


def test_phases_of_unequal_wheels_count_each():
    drive = DifferentialDrive(0.03, 0.2, 1.1)
    ends = [Pose2D(), drive.displacement(1.0, 1.0)]
    ends.append(ends[-1] @ drive.displacement(2.0, 2.0))
    (phase,) = phases_of([Look(ANY_FRAME, end) for end in ends], drive)
    assert (phase.left, phase.right) == pytest.approx((3.0, 3.0))


def test_twist_of_a_finished_motion_is_none():
    assert list(lived(SpinMotion(LIMITS)))[-1][1].twist == Twist2D()
