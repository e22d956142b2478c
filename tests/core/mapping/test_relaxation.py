"""Relaxation on paths whose truth is known."""

from __future__ import annotations

import math

import numpy as np

from omnibotd.core.mapping.relaxation import Differences, joined, relax_headings, relax_positions


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
    result = relax_positions(measured, 60, 59)
    assert np.abs(drifting - truth).max() > 0.5
    assert np.abs(result - truth).max() < 0.05


def test_a_wrong_link_is_doubted() -> None:
    truth = circle(60)
    wrong = link(10, 40, (0.0, 0.0), 0.05)
    right = [link(0, 59, truth[59], 0.05), link(5, 50, truth[50] - truth[5], 0.05)]
    result = relax_positions(joined([steps_of(truth, 0.01), wrong, *right]), 60, 59, rounds=10)
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
    assert np.abs(relax_positions(measured, 20, 19)[0]).max() < 1e-6
