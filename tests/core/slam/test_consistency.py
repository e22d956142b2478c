"""What the monitor says of innovations, and the bands that errors are held against."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.slam.consistency import InnovationMonitor, State, chi_square_band, squared_error


def fed(squares: np.ndarray, accepted: np.ndarray) -> InnovationMonitor:
    monitor = InnovationMonitor()
    monitor.see(len(squares), 0)
    monitor.add(squares[accepted], accepted)
    return monitor


@pytest.mark.parametrize(
    ("freedom", "low", "high"), [(150, 0.7865, 1.2387), (60, 0.6747, 1.3883), (10, 0.3247, 2.0483)]
)
def test_band_is_the_one_in_the_tables(freedom: int, low: float, high: float) -> None:
    assert chi_square_band(freedom) == pytest.approx((low, high), rel=0.01)


def test_squared_error_of_one_standard_deviation_each_is_its_length() -> None:
    assert squared_error(np.array([0.2, 0.1]), np.diag([0.04, 0.01])) == pytest.approx(2.0)


def test_honest_innovations_are_consistent() -> None:
    squares = np.random.default_rng(1).standard_normal(60) ** 2
    assert fed(squares, squares < 12.0).health.state is State.CONSISTENT


def test_without_bearings_of_the_map_it_is_blind() -> None:
    monitor = InnovationMonitor()
    assert monitor.health.state is State.BLIND
    monitor.see(0, 100)
    assert monitor.health.state is State.BLIND


def test_it_is_blind_again_when_the_map_goes_out_of_sight() -> None:
    monitor = fed(np.ones(60), np.ones(60, dtype=bool))
    assert monitor.health.state is State.CONSISTENT
    monitor.see(0, 60)
    assert monitor.health.state is State.BLIND


def test_innovations_twice_too_large_strain() -> None:
    squares = 4.0 * np.random.default_rng(1).standard_normal(60) ** 2
    assert fed(squares[squares < 12], np.ones((squares < 12).sum(), dtype=bool)).health.state is State.STRAINED


def test_a_divergence_is_remembered_when_innovations_are_fine_again() -> None:
    monitor = fed(np.full(60, 1.0), np.arange(60) % 2 == 0)
    assert monitor.health.state is State.DIVERGED
    monitor.see(60, 0)
    monitor.add(np.ones(60), np.ones(60, dtype=bool))
    assert monitor.health.state is State.DIVERGED
    assert "contradict the map" in monitor.health.reason


def test_a_strain_that_a_whole_window_does_not_end_is_a_divergence() -> None:
    """One bearing in five refused: a fifth is more than sensors misread, and less than a broken map."""
    monitor, accepted = InnovationMonitor(), np.arange(60) % 5 != 0
    for expected in (State.STRAINED, State.DIVERGED):
        monitor.see(60, 0)
        monitor.add(np.full(48, 0.2), accepted)
        assert monitor.health.state is expected
    assert "strained for" in monitor.health.reason


def test_a_strain_that_passes_leaves_nothing_behind() -> None:
    monitor = InnovationMonitor()
    for accepted in (np.arange(60) % 5 != 0, np.ones(60, bool), np.arange(60) % 5 != 0, np.ones(60, bool)):
        monitor.see(60, 0)
        monitor.add(np.full(int(accepted.sum()), 0.2), accepted)
    assert monitor.health.state is State.CONSISTENT
