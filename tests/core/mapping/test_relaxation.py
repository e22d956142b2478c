"""Relaxation on paths whose truth is known."""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_matrix

from omnibotd.core.mapping.relaxation import Differences, joined, relax_headings, relax_positions, relaxed


def circle(nodes: int) -> np.ndarray:
    angles = np.arange(nodes) * 2 * math.pi / nodes
    return np.column_stack([np.cos(angles) - 1.0, np.sin(angles)])


def steps_of(values: np.ndarray, sigma: float) -> Differences:
    node = np.arange(1, len(values))
    return Differences(node - 1, node, np.diff(values, axis=0), np.full(len(node), sigma))


def link(first: int, second: int, value: object, sigma: float) -> Differences:
    return Differences(np.array([first]), np.array([second]), np.array([value]), np.array([sigma]))


def test_closing_a_loop_spreads_the_drift() -> None:
    truth = circle(60)
    drifting = truth + np.linspace(0.0, 0.6, 60)[:, None]
    measured = joined([steps_of(drifting, 0.02), link(0, 59, truth[59], 0.01)])
    result = relax_positions(measured, np.zeros((60, 2)), 59)
    assert np.abs(drifting - truth).max() > 0.5
    assert np.abs(result - truth).max() < 0.05


def test_a_wrong_link_is_doubted() -> None:
    truth = circle(60)
    wrong = link(10, 40, (0.0, 0.0), 0.05)
    right = [link(0, 59, truth[59], 0.05), link(5, 50, truth[50] - truth[5], 0.05)]
    result = relax_positions(joined([steps_of(truth, 0.01), wrong, *right]), np.zeros((60, 2)), 59, rounds=10)
    assert np.abs(result - truth).max() < 0.05


def test_headings_wrap() -> None:
    truth = np.linspace(0.0, 6 * math.pi, 80)
    turns = np.diff(truth) + 0.004  # a gyroscope's drift: 18 degrees in all
    node = np.arange(1, 80)
    odometry = Differences(node - 1, node, turns, np.full(79, 0.01))
    # Three whole turns later the same heading is seen again.
    seen = link(0, 79, 0.0, 0.005)
    start = np.concatenate([[0.0], np.cumsum(turns)])
    result = relax_headings(joined([odometry, seen]), start)
    assert np.abs(start - truth).max() > 0.3
    assert np.abs(result - truth).max() < 0.05


def test_the_first_node_stays() -> None:
    measured = joined([steps_of(circle(20), 0.05), link(0, 19, (1.0, 1.0), 0.01)])
    assert (relax_positions(measured, np.zeros((20, 2)), 19)[0] == 0.0).all()


def test_held_nodes_stay_exactly_and_the_others_fit_them() -> None:
    """A map's nodes keep their poses to the bit while a new drive of drifting odometry is laid along them."""
    truth = circle(60)
    start = truth + np.concatenate([np.zeros((20, 2)), np.full((40, 2), 0.4)])
    drifting = truth[19:] + np.linspace(0.0, 0.6, 41)[:, None]
    odometry = steps_of(drifting, 0.02)
    odometry = Differences(odometry.first + 19, odometry.second + 19, odometry.value, odometry.sigma)
    measured = joined([odometry, link(0, 59, truth[59] - truth[0], 0.01), link(10, 40, truth[40] - truth[10], 0.01)])
    result = relax_positions(measured, start, len(odometry), held=20)
    np.testing.assert_array_equal(result[:20], truth[:20])
    assert np.abs(result - truth).max() < 0.05
    headings = relax_headings(link(5, 30, 0.3, 0.01), np.concatenate([np.full(30, 0.1), [0.0]]), held=30)
    np.testing.assert_array_equal(headings[:30], 0.1)
    assert abs(headings[30] - 0.4) < 1e-6


def test_reweighting_ends_where_a_fresh_factorisation_would() -> None:
    """Three measurements of one difference, one of them far off: the fixed point of Cauchy weights, by hand."""
    values, sigma = np.array([[1.0], [1.02], [3.0]]), np.full(3, 0.1)
    expected = np.array([1.673])
    for _ in range(40):
        weights = 1.0 / (1.0 + ((expected - values[:, 0]) / 0.2) ** 2)
        expected = (weights @ values) / weights.sum()
    result = relaxed(csr_matrix(np.ones((3, 1))), values, sigma, trusted=0, rounds=41)
    assert abs(result[0, 0] - expected[0]) < 1e-6
