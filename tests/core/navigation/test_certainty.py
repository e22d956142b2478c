"""What agreeing estimates prove, on wheels of any quality."""

import math

import pytest

from omnibotd.core.decision import Observation
from omnibotd.core.geometry import Pose2D
from omnibotd.core.navigation.certainty import Certainty
from omnibotd.core.percept import PlaceEstimate

STEP = 0.08  # rad a tick


def turn_on_the_spot(*, odometry: float, view: float, turned: float = 1.05 * math.tau) -> Certainty:
    """Turn by `turned` as odometry tells it; it and the views tell these shares of the true turn."""
    certainty = Certainty()
    for tick in range(math.ceil(turned / (STEP * odometry)) + 1):
        odom = Pose2D(yaw=odometry * STEP * tick)
        here = Pose2D(1.0, 2.0, view * STEP * tick)
        certainty.take(
            Observation(0.1 * tick, odom, PlaceEstimate(0.1 * tick, odom, here, 0.9, 0.02, 0.8, 0.3, 7)), here
        )
    return certainty


@pytest.mark.parametrize("odometry", [0.91, 1.0, 1.1])
def test_one_turn_on_wheels_of_a_wrong_size_proves_the_place(odometry: float) -> None:
    assert turn_on_the_spot(odometry=odometry, view=1.0).proven


@pytest.mark.parametrize("view", [0.0, 0.5, -1.0])
def test_a_place_that_does_not_turn_with_the_robot_proves_nothing(view: float) -> None:
    certainty = turn_on_the_spot(odometry=1.0, view=view)
    assert not certainty.proven
    assert not certainty.found
