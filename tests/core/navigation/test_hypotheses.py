"""Proposing, merging and reweighing of poses the robot may have."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.navigation.hypotheses import Hypotheses

# The second is 20 cm from the first; the third elsewhere; the fourth at the first place, but turned round.
POSES = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.1], [3.0, 1.0, 3.1], [0.0, 0.0, 2.0]])
SCORES = np.array([0.9, 0.85, 0.8, 0.8])
SIGMAS = np.array([0.1, 0.2, 0.3, 0.4])


def proposed() -> Hypotheses:
    hypotheses = Hypotheses()
    hypotheses.propose(POSES, SCORES, SIGMAS)
    return hypotheses


def test_one_hypothesis_a_place_and_heading_best_first() -> None:
    hypotheses = proposed()
    np.testing.assert_array_equal(hypotheses.poses, POSES[[0, 2, 3]])
    np.testing.assert_array_equal(hypotheses.sigmas, SIGMAS[[0, 2, 3]])
    # A correlation 0.1 lower is e^2 times less likely.
    assert hypotheses.share() == pytest.approx(1.0 / (1.0 + 2.0 * np.exp(-2.0)))


def test_a_place_already_held_is_not_proposed_again() -> None:
    hypotheses = proposed()
    before = hypotheses.log_weights.copy()
    hypotheses.propose(POSES + np.array([0.1, 0.1, -0.05]), SCORES, SIGMAS)
    np.testing.assert_array_equal(hypotheses.log_weights, before)


def test_headings_are_compared_across_the_half_turn() -> None:
    hypotheses = proposed()
    hypotheses.propose(np.array([[3.0, 1.0, -3.1]]), np.array([0.9]), np.array([0.1]))
    assert len(hypotheses) == 3


def test_a_single_hypothesis_keeps_all_the_weight() -> None:
    hypotheses = Hypotheses()
    hypotheses.propose(POSES[:1], SCORES[:1], SIGMAS[:1])
    hypotheses.weigh(POSES[2:3], SCORES[2:3], np.zeros(1), 1.0)
    assert hypotheses.share() == 1.0


def test_hypotheses_that_run_together_become_the_likelier_one() -> None:
    hypotheses = proposed()
    hypotheses.place(1, Pose2D(0.05, 0.0, 0.0), 0.05)
    hypotheses.weigh(POSES, SCORES, np.zeros(3), 0.1)
    np.testing.assert_array_equal(hypotheses.poses, POSES[[0, 3]])
    assert np.exp(hypotheses.log_weights).sum() == pytest.approx(1.0)
