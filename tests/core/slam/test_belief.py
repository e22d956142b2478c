"""The joint belief: what parts do to each other, and that it stays one."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.slam.belief import Belief
from omnibotd.core.slam.motion import VelocityNoise, constant_velocity


def made() -> Belief:
    """A vehicle that knows its pose to (0.2, 0.1, 0.05), and a landmark 1 m north of it."""
    belief = Belief(np.zeros(3), np.diag([0.04, 0.01, 0.0025]))
    jacobian = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    belief.append("lamp", np.array([0.0, 1.0]), jacobian, 0.01 * np.eye(2))
    return belief


def test_a_landmark_seen_from_the_vehicle_shares_its_error() -> None:
    belief = made()
    assert belief.covariance[3, 3] == pytest.approx(0.04 + 0.0025 + 0.01)
    assert belief.covariance[3, 0] == pytest.approx(0.04)
    assert belief.covariance[3, 2] == pytest.approx(-0.0025)


def test_a_frozen_pose_stays_and_its_correlation_moves_on() -> None:
    belief = Belief(np.array([0, 0, 0.3, 0.5, 0.2]), np.diag([0.04, 0.01, 0.0025, 0.1, 0.1]))
    belief.freeze("first")
    motion = constant_velocity(belief.mean[:5], 0.5, VelocityNoise())
    before = belief.covariance.copy()
    belief.move(motion)
    assert belief.mean[belief.span("first")] == pytest.approx([0, 0, 0.3])
    assert belief.covariance[5:, 5:] == pytest.approx(before[:3, :3])
    assert belief.covariance[:5, 5:] == pytest.approx(motion.jacobian @ before[:5, :3])


def test_removing_a_part_leaves_the_rest_as_it_was() -> None:
    belief = made()
    alone = belief.covariance[:3, :3].copy()
    belief.append("door", np.array([5.0, 5.0]), np.zeros((2, 5)), np.eye(2))
    belief.remove("lamp")
    assert belief.names == ("door",)
    assert belief.mean[belief.span("door")] == pytest.approx([5.0, 5.0])
    assert belief.covariance[:3, :3] == pytest.approx(alone)
    assert belief.covariance[3:, 3:] == pytest.approx(np.eye(2))


def test_replacing_a_part_carries_its_correlations() -> None:
    belief = made()
    cross = belief.covariance[:3, 3:].copy()
    half = np.array([[0.5, 0.0]])
    belief.replace("lamp", np.array([0.7]), half)
    assert belief.mean[belief.span("lamp")] == pytest.approx([0.7])
    assert belief.covariance[:3, 3:] == pytest.approx(cross @ half.T)


def test_correction_is_the_weighted_mean_of_what_is_known() -> None:
    """Of x, known to 0.2, measured to 0.1 as 0.5: the textbook's answer."""
    belief = made()
    jacobian = np.zeros((1, 5))
    jacobian[0, 0] = 1.0
    belief.correct(jacobian, np.array([0.01]), np.array([0.5]))
    assert belief.mean[0] == pytest.approx(0.5 * 0.04 / 0.05)
    assert belief.covariance[0, 0] == pytest.approx(1 / (1 / 0.04 + 1 / 0.01))


def test_heading_is_wrapped_after_a_correction() -> None:
    belief = Belief(np.array([0.0, 0.0, 3.1]), np.eye(3))
    belief.correct(np.array([[0.0, 0.0, 1.0]]), np.array([1e-9]), np.array([0.1]))
    assert belief.mean[2] == pytest.approx(3.2 - 2 * np.pi, abs=1e-6)


def test_covariance_stays_positive_definite_over_a_million_units_of_precision() -> None:
    """The plain form (I - KH) P goes negative here: a wide prior met by sharp, nearly parallel measurements."""
    rng = np.random.default_rng(0)
    belief = Belief(np.zeros(3), 1e6 * np.eye(3))
    for _ in range(2000):
        jacobian = np.array([[1.0, 1.0, 1.0]]) + 1e-4 * rng.standard_normal((1, 3))
        belief.correct(jacobian, np.array([1e-6]), np.array([1e-3 * rng.standard_normal()]))
    assert np.array_equal(belief.covariance, belief.covariance.T)
    assert np.linalg.eigvalsh(belief.covariance)[0] > 0.0
