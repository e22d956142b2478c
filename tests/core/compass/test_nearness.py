"""What is learnt of how near things are: the ceiling holds the scale, and nothing is known too well."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.compass.nearness import Nearness

# Cells at zenith angles of 0 to 70 degrees: of the first four all is ceiling.
PLANE = np.cos(np.radians([5.0, 15.0, 25.0, 35.0, 50.0, 60.0, 70.0]))


def known(factor: float) -> Nearness:
    """All of the ceiling's plane, as if it were `factor` times as near, and known well."""
    return Nearness(PLANE.copy(), (factor - 1.0) * PLANE, np.full(len(PLANE), 1e-6))


def test_all_nearer_by_one_factor_is_taken_back() -> None:
    nearness = known(1.3)
    nearness.learn(np.zeros(len(PLANE)), np.zeros(len(PLANE)))
    assert nearness.excess == pytest.approx(0.0, abs=1e-12)


def test_what_differs_from_the_rest_stays_different() -> None:
    nearness = known(1.0)
    nearness.excess[5] = 0.4
    nearness.learn(np.zeros(len(PLANE)), np.zeros(len(PLANE)))
    assert nearness.excess[5] == pytest.approx(0.4)
    assert np.delete(nearness.excess, 5) == pytest.approx(0.0, abs=1e-12)


def test_where_no_ceiling_is_seen_nothing_holds_the_scale() -> None:
    nearness = Nearness(PLANE[4:].copy(), 0.3 * PLANE[4:], np.full(3, 1e-6))
    nearness.learn(np.zeros(3), np.zeros(3))
    assert nearness.excess == pytest.approx(0.3 * PLANE[4:])


def test_a_thousand_frames_make_nothing_surer_than_what_a_cell_mixes() -> None:
    nearness = known(1.0)
    for _ in range(1000):
        nearness.learn(np.zeros(len(PLANE)), np.full(len(PLANE), 1e6))
    assert np.sqrt(nearness.variance) == pytest.approx(0.05 * PLANE)


def test_a_frame_that_says_much_is_followed() -> None:
    nearness = Nearness(PLANE.copy(), np.zeros(len(PLANE)), np.full(len(PLANE), 0.3**2))
    excess = np.zeros(len(PLANE))
    excess[6] = 0.2
    nearness.learn(excess, np.full(len(PLANE), 1e6))
    assert nearness.excess[6] == pytest.approx(0.2, rel=1e-3)


def test_in_a_hall_what_may_be_ceiling_is_and_the_rest_is_as_learnt() -> None:
    nearness = known(1.1)
    nearness.excess[5] = 0.4
    believed = nearness.believed()
    assert believed.excess == pytest.approx(np.where(np.arange(len(PLANE)) == 5, 0.4, 0.0))
    assert np.delete(np.sqrt(believed.variance) / PLANE, 5) == pytest.approx(0.002)
    assert believed.variance[5] == 1e-6
    assert nearness.excess[0] == pytest.approx(0.1 * PLANE[0])


def test_where_walls_stand_all_is_as_learnt() -> None:
    nearness = known(1.1)
    nearness.excess[5:] = 0.4
    assert nearness.believed() is nearness


def test_what_is_only_guessed_makes_no_hall() -> None:
    nearness = Nearness(PLANE.copy(), np.zeros(len(PLANE)), np.full(len(PLANE), 0.6**2))
    assert nearness.believed() is nearness


def test_without_anything_low_there_is_no_telling() -> None:
    nearness = Nearness(PLANE[:4].copy(), 0.1 * PLANE[:4], np.full(4, 1e-6))
    assert nearness.believed() is nearness
