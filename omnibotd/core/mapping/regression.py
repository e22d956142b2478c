"""Metric pose from neighbours: how views change with position is learnt, locally and linearly, from the nodes themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.descriptor import RING_WEIGHTS, turn_derivative, turned
from omnibotd.core.vision.view import View

Floats = NDArray[np.float32]

NEIGHBOURS = 20
# Views change linearly over about this many metres under a room's ceiling; nodes farther off lose their say.
REACH = 0.15
# Ridge on the slopes, in the units of the weights: nodes all on one line say nothing about the direction across it.
_RIDGE = 0.02
# No step is longer than the range over which the model is linear.
_LONGEST_STEP = 0.2
# Neighbouring cells err together, as the model's own error does: so few of the 1024 are independent evidence.
_INDEPENDENT_SHARE = 0.03
# Prior standard deviation of the heading (rad): that of a turn found by correlation.
_YAW_SIGMA = 0.03


@dataclass(frozen=True, slots=True)
class Regressed:
    """A pose, its standard deviation (m) in the worst direction, and the mean absolute residual of the view."""

    pose: Pose2D
    sigma: float
    residual: float


def refine(view: View, prior: Pose2D, sigma: float, positions: Floats, aligned: View, rounds: int = 2) -> Regressed:
    """The likeliest pose of `view` (RINGS, SECTORS), given a prior good to `sigma` metres, from nodes at positions (k, 2)
    whose views (k, RINGS, SECTORS) are turned into map axes.

    Directions in which the nodes don't spread stay as the prior has them.
    """
    weighted = (aligned * RING_WEIGHTS).reshape(len(aligned), -1)
    information = np.diag([sigma**-2, sigma**-2, _YAW_SIGMA**-2])
    deviation = np.zeros(3)  # from the prior
    for _ in range(rounds):
        pose = np.array([prior.x, prior.y, prior.yaw]) + deviation
        jacobian, residual = _linearised(view, pose, positions, weighted)
        step, covariance, error = _most_likely(jacobian, residual, information, deviation)
        step[:2] *= min(1.0, _LONGEST_STEP / max(float(np.hypot(step[0], step[1])), 1e-9))
        deviation += step
        if np.abs(step[:2]).max() < 0.01:
            break
    spread = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    result = Pose2D(prior.x + float(deviation[0]), prior.y + float(deviation[1]), prior.yaw + float(deviation[2]))
    return Regressed(result, spread, error)


def _linearised(view: View, pose: NDArray[np.float64], positions: Floats, weighted: Floats) -> tuple[Floats, Floats]:
    """Jacobian (cells, 3) of the expected minus the turned view, and what is left to explain (cells,)."""
    model = _local_model(positions - pose[:2].astype(np.float32), weighted)
    query = turned(view, pose[2]) * RING_WEIGHTS
    slope = turn_derivative(query).ravel()
    return np.stack([model[1], model[2], -slope], 1), query.ravel() - model[0]


def _local_model(offsets: Floats, weighted: Floats) -> Floats:
    """(3, cells): the view expected here, and its slopes along x and y; weighted ridge regression."""
    weights = np.exp(-(offsets**2).sum(1) / (2.0 * REACH**2)) + 1e-3
    design = np.concatenate([np.ones((len(offsets), 1), np.float32), offsets], 1)
    normal = design.T * weights
    ridge = np.diag([0.0, 1.0, 1.0]) * _RIDGE * weights.sum() * REACH**2
    return np.asarray(np.linalg.solve(normal @ design + ridge, normal).astype(np.float32) @ weighted)


def _most_likely(
    jacobian: Floats, residual: Floats, information: NDArray[np.float64], deviation: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Step (3,), covariance (3, 3) and mean residual; Cauchy weights: lamps that went out and people shall not pull."""
    errors = np.abs(residual)
    for _ in range(3):
        scale = 1.48 * float(np.median(errors)) + 1e-3
        weights = 1.0 / (1.0 + (errors / (2.0 * scale)) ** 2)
        normal = jacobian.T * (weights * (_INDEPENDENT_SHARE / scale**2))
        covariance = np.linalg.inv((normal @ jacobian).astype(np.float64) + information)
        step = covariance @ (normal @ residual - information @ deviation)
        errors = np.abs(residual - jacobian @ step.astype(np.float32))
    return step, covariance, float(errors.mean())
