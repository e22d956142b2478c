"""Metric pose from neighbours: the nodes round about predict the view from any pose, and how it changes there.

The prediction is kriging (Gaussian process regression over position) rather than a local line: where nodes are sparse
its slopes fade, so that it never pulls a pose where no node has been.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.descriptor import RING_WEIGHTS, turn_derivative, turned
from omnibotd.core.vision.view import View

Floats = NDArray[np.float32]

NEIGHBOURS = 20
RADIUS = 0.6
# Length over which views stay alike (m), Matern 3/2, and noise variance in units of a cell's own: fitted to how
# correlation falls with distance, 0.92 at 8 cm, 0.6 at 25 cm.
_LENGTH, _NOISE = 0.35, 0.1
# No step is longer than the range over which the model is linear.
_LONGEST_STEP = 0.2
# Neighbouring cells err together, as the model's own error does: so few of the 1024 are independent evidence.
_INDEPENDENT_SHARE = 0.03
# Prior standard deviation of the heading (rad): that of a turn found by correlation.
_YAW_SIGMA = 0.03


@dataclass(frozen=True, slots=True)
class Regressed:
    """A pose, its standard deviation (m) in the worst direction, and how the view correlates with the predicted one."""

    pose: Pose2D
    sigma: float
    score: float


def refine(view: View, prior: Pose2D, sigma: float, positions: Floats, aligned: View, rounds: int = 2) -> Regressed:
    """The likeliest pose of `view` (RINGS, SECTORS), given a prior good to `sigma` metres.

    Nodes are given by positions (k, 2) and views (k, RINGS, SECTORS) turned into map axes.

    Directions of which the nodes know nothing stay as the prior has them.
    """
    weighted = (aligned * RING_WEIGHTS).reshape(len(aligned), -1)
    information = np.diag([sigma**-2, sigma**-2, _YAW_SIGMA**-2])
    deviation = np.zeros(3)  # from the prior
    for _ in range(rounds):
        pose = np.array([prior.x, prior.y, prior.yaw]) + deviation
        jacobian, query, expected = _linearised(view, pose, positions, weighted)
        step, covariance = _most_likely(jacobian, query - expected, information, deviation)
        step[:2] *= min(1.0, _LONGEST_STEP / max(float(np.hypot(step[0], step[1])), 1e-9))
        deviation += step
        if np.abs(step[:2]).max() < 0.01:
            break
    spread = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    result = Pose2D(prior.x + float(deviation[0]), prior.y + float(deviation[1]), prior.yaw + float(deviation[2]))
    return Regressed(result, spread, _correlation(query, expected + jacobian @ step.astype(np.float32)))


def _linearised(
    view: View, pose: NDArray[np.float64], positions: Floats, weighted: Floats
) -> tuple[Floats, Floats, Floats]:
    """Jacobian (cells, 3) of the expected minus the turned view; the turned view (cells,); the expected one."""
    model = _predicted(positions - pose[:2].astype(np.float32), weighted)
    query = turned(view, pose[2]) * RING_WEIGHTS
    slope = turn_derivative(query).ravel()
    return np.stack([model[1], model[2], -slope], 1), query.ravel(), model[0]


def _predicted(offsets: Floats, weighted: Floats) -> Floats:
    """(3, cells): the view expected at offset zero, and its slopes along x and y (universal kriging, constant mean)."""
    rate = math.sqrt(3.0) / _LENGTH
    apart = np.hypot(offsets[:, None, 0] - offsets[:, 0], offsets[:, None, 1] - offsets[:, 1])
    covariance = (1.0 + rate * apart) * np.exp(-rate * apart) + _NOISE * np.eye(len(offsets))
    away = np.hypot(offsets[:, 0], offsets[:, 1])
    decay = np.exp(-rate * away)
    here = np.column_stack([(1.0 + rate * away) * decay, (rate * rate * decay)[:, None] * offsets])
    inverse = np.linalg.inv(covariance)
    influence = inverse @ here
    mean = inverse.sum(1) / inverse.sum()
    influence += np.outer(mean, np.array([1.0, 0.0, 0.0]) - influence.sum(0))
    return np.asarray(influence.T.astype(np.float32) @ weighted)


def _most_likely(
    jacobian: Floats, residual: Floats, information: NDArray[np.float64], deviation: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Step (3,) and covariance (3, 3); Cauchy weights: lamps that went out and people in view shall not pull."""
    errors = np.abs(residual)
    for _ in range(3):
        scale = 1.48 * float(np.median(errors)) + 1e-3
        weights = 1.0 / (1.0 + (errors / (2.0 * scale)) ** 2)
        normal = jacobian.T * (weights * (_INDEPENDENT_SHARE / scale**2))
        covariance = np.asarray(np.linalg.inv((normal @ jacobian).astype(np.float64) + information), np.float64)
        step = covariance @ (normal @ residual - information @ deviation)
        errors = np.abs(residual - jacobian @ step.astype(np.float32))
    return step, covariance


def _correlation(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(float(np.sqrt((a @ a) * (b @ b))), 1e-9))
