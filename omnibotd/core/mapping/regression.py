"""Metric pose from neighbours: the nodes round about predict the view from any pose, and how it changes there.

The prediction is kriging (Gaussian process regression over position) rather than a local line: where nodes are sparse
its slopes fade, so that it never pulls a pose where no node has been.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.descriptor import RING_WEIGHTS, turned_with_slope
from omnibotd.core.vision.view import SECTORS, View

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

NEIGHBOURS = 20
# The first ring of the rim, 60 degrees from the vertical: from there on there are walls and furniture in a room.
_RIM = 12
RADIUS = 0.6
# Length over which views stay alike (m), Matern 3/2, and noise variance in units of a cell's own: fitted to how
# correlation falls with distance, 0.92 at 8 cm, 0.6 at 25 cm.
_LENGTH, _NOISE = 0.35, 0.1
# No step is longer than the range over which the model is linear.
_LONGEST_STEP = 0.2
# Neighbouring cells err together, as the model's own error does: so few of the 1024 are independent evidence.
_INDEPENDENT_SHARE = 0.03
# Between nodes the model errs in ways that all cells share: unexplained variance (of 1) at which half the evidence is
# left, fitted to errors against their predicted spread under tiles, plaster, beams and in a photographed room.
_UNEXPLAINED = 0.12
# Prior standard deviation of the heading (rad): that of a turn found by correlation.
_YAW_SIGMA = 0.03
_CELL_WEIGHTS = np.repeat(RING_WEIGHTS.ravel(), SECTORS)
# What is predicted where all nodes see the same constant: it, and no slopes.
_OF_A_CONSTANT = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class Regressed:
    """A pose, its standard deviation (m) in the worst direction, how the view correlates with the predicted one, the
    share of a view's variance that the nodes leave unexplained there (0 at a node, 1 far from all), and how the `rim`
    alone correlates, the outer quarter of the view (NaN where the lens does not see that far)."""

    pose: Pose2D
    sigma: float
    score: float
    unexplained: float
    rim: float


def refine(
    view: View,
    prior: Pose2D,
    sigma: float,
    positions: Floats,
    aligned: View,
    *,
    rounds: int = 2,
    evidence: float = 1.0,
) -> Regressed:
    """The likeliest pose of `view` (RINGS, SECTORS), given a prior good to `sigma` metres.

    `evidence` in (0, 1] says how independent this view is of those that made the prior.
    Nodes are given by positions (k, 2) and views (k, RINGS, SECTORS) turned into map axes.

    Directions of which the nodes know nothing stay as the prior has them.
    """
    views = aligned.reshape(len(aligned), -1)
    prior_information = np.diag([sigma**-2, sigma**-2, _YAW_SIGMA**-2])
    deviation = np.zeros(3)  # from the prior
    for _ in range(rounds):
        pose = np.array([prior.x, prior.y, prior.yaw]) + deviation
        jacobian, query, expected, unexplained = _linearised(view, pose, positions, views)
        share = evidence * _INDEPENDENT_SHARE / (1.0 + (unexplained / _UNEXPLAINED) ** 2)
        step, covariance = _most_likely(jacobian, query - expected, share, prior_information, deviation)
        step[:2] *= min(1.0, _LONGEST_STEP / max(float(np.hypot(step[0], step[1])), 1e-9))
        deviation += step
        if np.abs(step[:2]).max() < 0.01:
            break
    result = Pose2D(prior.x + float(deviation[0]), prior.y + float(deviation[1]), prior.yaw + float(deviation[2]))
    expected = expected + step.astype(np.float32) @ jacobian
    score, rim = _correlation(query, expected), _correlation_at_rim(query, expected)
    return Regressed(result, _spread(covariance), score, unexplained, rim)


def _linearised(view: View, pose: Doubles, positions: Floats, views: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Jacobian (3, cells) of the expected minus the turned view; the turned view (cells,); the expected one, and the
    share of its variance that the nodes leave unexplained."""
    model, unexplained = _predicted(positions - pose[:2].astype(np.float32), views)
    query, slope = (part.ravel() * _CELL_WEIGHTS for part in turned_with_slope(view, float(pose[2])))
    expected, along_x, along_y = model * _CELL_WEIGHTS
    return np.stack([along_x, along_y, -slope]), query, expected, unexplained


def _predicted(offsets: Floats, views: Floats) -> tuple[Floats, float]:
    """(3, cells): the view expected at offset zero, and its slopes along x and y (universal kriging, constant mean);
    and the kriging variance, of 1."""
    rate = math.sqrt(3.0) / _LENGTH
    apart = np.hypot(offsets[:, None, 0] - offsets[:, 0], offsets[:, None, 1] - offsets[:, 1])
    covariance = (1.0 + rate * apart) * np.exp(-rate * apart) + _NOISE * np.eye(len(offsets))
    away = np.hypot(offsets[:, 0], offsets[:, 1])
    decay = np.exp(-rate * away)
    here, slopes = (1.0 + rate * away) * decay, (rate * rate * decay)[:, None] * offsets
    _, solved = cv2.solve(covariance, np.column_stack([here, slopes, np.ones(len(here))]), flags=cv2.DECOMP_CHOLESKY)
    influence, mean = solved[:, :3], solved[:, 3:] / solved[:, 3].sum()
    unexplained = 1.0 - float(here @ influence[:, 0])
    influence = influence + mean * (_OF_A_CONSTANT - influence.sum(0))
    return np.asarray(influence.T.astype(np.float32) @ views), unexplained


def _most_likely(
    jacobian: Floats, residual: Floats, share: float, information: Doubles, deviation: Doubles
) -> tuple[Doubles, Doubles]:
    """Step (3,) and covariance (3, 3); Cauchy weights: lamps that went out and people in view shall not pull."""
    errors = np.abs(residual)
    # Outside the image both views are exactly zero: the median is that of the errors above these.
    middle = min(len(errors) - (int(np.count_nonzero(residual)) + 1) // 2, len(errors) - 1)
    for _ in range(3):
        scale = 1.48 * float(np.partition(errors, middle)[middle]) + 1e-3
        weights = 1.0 / (1.0 + (errors / (2.0 * scale)) ** 2)
        normal = jacobian * (weights * (share / scale**2))
        _, covariance = cv2.invert((normal @ jacobian.T).astype(np.float64) + information, flags=cv2.DECOMP_CHOLESKY)
        step = covariance @ (normal @ residual - information @ deviation)
        errors = np.abs(residual - step.astype(np.float32) @ jacobian)
    return step, np.asarray(covariance, np.float64)


def _spread(covariance: Doubles) -> float:
    """Standard deviation in the worst direction: root of the larger eigenvalue over the first two axes."""
    (xx, xy), (_, yy) = covariance[:2, :2].tolist()
    return math.sqrt((xx + yy) / 2.0 + math.hypot((xx - yy) / 2.0, xy))


def _correlation_at_rim(query: Floats, expected: Floats) -> float:
    query, expected = query[_RIM * SECTORS :], expected[_RIM * SECTORS :]
    seen = np.count_nonzero(query) >= len(query) // 2  # what is not seen is exactly zero
    return _correlation(query, expected) if seen else math.nan


def _correlation(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(float(np.sqrt((a @ a) * (b @ b))), 1e-9))
