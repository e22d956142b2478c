"""The filter and the stop rule, against numbers worked out by hand."""

import math

import pytest

from omnibotd.core.thesis.offset_filter import FLOOR, OffsetFilter


def test_it_starts_from_its_first_measurement() -> None:
    offset = OffsetFilter((3.0, -4.0), 0.08)
    assert offset.offset == (3.0, -4.0)
    assert offset.variance == 0.08
    assert offset.distance == 5.0


def test_prediction_takes_the_motion_off_and_adds_two_per_cent_of_it() -> None:
    offset = OffsetFilter((1.0, 2.0), 0.01)
    offset.predict(0.3, 0.4)  # 0.5 m
    assert offset.offset == pytest.approx((0.7, 1.6))
    assert offset.variance == pytest.approx(0.01 + 0.02 * 0.5)


def test_update_weighs_by_variance() -> None:
    """s = 0.03, r = 0.01: gain 3/4, and 0.03 - 0.0009 / 0.04 = 0.0075."""
    offset = OffsetFilter((1.0, 1.0), 0.03)
    offset.update((2.0, 0.6), 0.01)
    assert offset.offset == pytest.approx((1.75, 0.7))
    assert offset.variance == pytest.approx(0.0075)


def test_many_measurements_never_make_it_surer_than_the_floor() -> None:
    offset = OffsetFilter((1.0, 0.0), 0.02)
    for _ in range(100):
        offset.update((1.0, 0.0), 0.02)
    assert offset.variance == FLOOR
    offset.update((0.0, 0.0), 0.0)  # the target's own node is certain of itself
    assert offset.offset == pytest.approx((0.0, 0.0))


@pytest.mark.parametrize(
    ("z", "r", "arrived"),
    [
        ((0.10, 0.11), 0.0025, True),  # 0.149 m
        ((0.11, 0.11), 0.0025, False),  # 0.156 m, each beyond its 0.05 m
        ((0.29, 0.29), 0.09, True),  # both within 0.3 m
        ((0.29, 0.31), 0.09, False),  # one is not
    ],
)
def test_the_stop_rule(z: tuple[float, float], r: float, arrived: bool) -> None:
    assert math.sqrt(0.0025) == 0.05
    assert OffsetFilter(z, r).arrived() is arrived
