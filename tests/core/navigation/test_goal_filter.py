import math

import numpy as np

from omnibotd.core.geometry import Pose2D
from omnibotd.core.navigation.goal_filter import AGREEING, GoalFilter
from omnibotd.core.percept import PlaceEstimate


def place(odom: Pose2D, where: Pose2D, confidence: float = 0.95, sigma: float = 0.05) -> PlaceEstimate:
    return PlaceEstimate(0.0, odom, where, confidence, sigma, 0.9, 0.3, 0)


def test_noise_is_averaged_and_the_variance_says_how_well() -> None:
    rng = np.random.default_rng(1)
    errors, variances = [], []
    for _ in range(50):
        goal_filter = GoalFilter()
        odom = Pose2D()
        for _ in range(30):
            odom = odom @ Pose2D(0.02, 0.0, 0.0)
            goal_filter.predict(odom)
            x, y = rng.normal(0.0, 0.05, 2)
            goal_filter.update(place(odom, Pose2D(odom.x + x, odom.y + y)), 0.5)
        assert goal_filter.map_from_base is not None
        errors.append(goal_filter.map_from_base.distance(odom))
        variances.append(goal_filter.variance)
    assert np.sqrt(np.mean(np.square(errors)) / 2) < 0.025
    assert np.sqrt(np.mean(variances)) < 0.03


def test_an_estimate_is_carried_from_its_own_stamp_to_now() -> None:
    goal_filter = GoalFilter()
    goal_filter.predict(Pose2D(1.0, 0.0, 0.0))
    goal_filter.update(place(Pose2D(0.8, 0.0, 0.0), Pose2D(5.0, 5.0, math.pi / 2)), 0.5)
    assert goal_filter.map_from_base is not None
    assert goal_filter.map_from_base.distance(Pose2D(5.0, 5.2)) < 1e-9


def test_unsure_estimates_move_nothing() -> None:
    goal_filter = GoalFilter()
    goal_filter.predict(Pose2D())
    goal_filter.update(place(Pose2D(), Pose2D(1.0, 1.0)), 0.5)
    goal_filter.update(place(Pose2D(), Pose2D(3.0, 1.0), confidence=0.3), 0.5)
    assert goal_filter.map_from_base == Pose2D(1.0, 1.0)
    assert goal_filter.confidence == 0.3


def test_one_wild_estimate_is_held_back_and_several_that_agree_are_a_carried_robot() -> None:
    goal_filter = GoalFilter()
    goal_filter.predict(Pose2D())
    goal_filter.update(place(Pose2D(), Pose2D()), 0.5)
    goal_filter.update(place(Pose2D(), Pose2D(2.0, 0.0)), 0.5)
    assert goal_filter.map_from_base == Pose2D()
    for _ in range(AGREEING - 1):
        goal_filter.update(place(Pose2D(), Pose2D(2.0, 0.01)), 0.5)
    assert goal_filter.map_from_base is not None
    assert goal_filter.map_from_base.distance(Pose2D(2.0, 0.0)) < 0.02


def test_wild_estimates_that_disagree_never_win() -> None:
    goal_filter = GoalFilter()
    goal_filter.predict(Pose2D())
    goal_filter.update(place(Pose2D(), Pose2D()), 0.5)
    for k in range(20):
        goal_filter.update(place(Pose2D(), Pose2D(2.0 + (k % 2), 0.0)), 0.5)
    assert goal_filter.map_from_base == Pose2D()
