"""Sharpening a relaxed path: every node is placed by local regression among the nodes of other visits, then relaxed again.

Links between views carry no offset, only "about here"; the regression measures the offset, to about 2 cm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix, vstack

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping import regression
from omnibotd.core.mapping.links import REVISIT, PathLinker, odometry_offsets
from omnibotd.core.mapping.relaxation import Floats, relaxed
from omnibotd.core.vision.descriptor import turned
from omnibotd.core.vision.view import View

# Fewer neighbours than this, or farther than this, carry no slope worth having.
_FEWEST, _RADIUS = 6, 0.4
# How good relaxed positions are before (m), what a measurement must reach to be worth it, and how it is weighed.
_PRIOR, _USEFUL, _SIGMA = 0.1, 0.06, 0.03


def refined_poses(views: View, linker: PathLinker, steps: Floats) -> NDArray[np.float64]:
    """(N, 3) poses; the linker's own where too few places were visited twice."""
    poses = linker.poses
    aligned = turned(views, poses[:, 2])
    rows, offsets = [], []
    for node in range(len(poses)):
        near = _other_visits(node, poses, linker.travelled)
        if len(near) >= _FEWEST:
            measured = _measure(node, near, views, poses, aligned)
            if measured is not None:
                rows.append((node, near, measured[0]))
                offsets.append(measured[1])
    odometry = odometry_offsets(steps, poses[:, 2])
    trusted = len(odometry)
    matrix = vstack(
        [odometry.rows(len(poses)), linker.links.revisits().rows(len(poses)), _matrix(rows, len(poses))]
    ).tocsr()
    revisits = linker.links.revisits()
    values = np.concatenate([odometry.value, revisits.value, np.array(offsets).reshape(-1, 2)])
    # The offset-free links only have to hold what the regression can't reach: loosen them.
    sigma = np.concatenate([odometry.sigma, 3.0 * revisits.sigma, np.full(len(rows), _SIGMA)])
    return np.column_stack([relaxed(matrix, values, sigma, trusted), poses[:, 2]])


def _other_visits(node: int, poses: Floats, travelled: Floats) -> NDArray[np.intp]:
    apart = np.hypot(poses[:, 0] - poses[node, 0], poses[:, 1] - poses[node, 1])
    apart[np.abs(travelled - travelled[node]) < REVISIT] = np.inf
    near = np.flatnonzero(apart < _RADIUS)
    if len(near) <= regression.NEIGHBOURS:
        return near
    return near[np.argpartition(apart[near], regression.NEIGHBOURS)[: regression.NEIGHBOURS]]


def _measure(
    node: int, near: NDArray[np.intp], views: View, poses: Floats, aligned: View
) -> tuple[Floats, Floats] | None:
    """Weights (k,) of the neighbours and the node's offset (2,) from their weighted mean."""
    x, y, yaw = (float(value) for value in poses[node])
    positions = poses[near, :2].astype(np.float32)
    found = regression.refine(views[node], Pose2D(x, y, yaw), _PRIOR, positions, aligned[near], rounds=1)
    if found.sigma > _USEFUL:
        return None
    weights = np.exp(-((poses[near, :2] - (x, y)) ** 2).sum(1) / (2.0 * regression.REACH**2)) + 1e-3
    weights /= weights.sum()
    return weights, np.array([found.pose.x, found.pose.y]) - weights @ poses[near, :2]


def _matrix(rows: list[tuple[int, NDArray[np.intp], Floats]], nodes: int) -> csr_matrix:
    """One row a measurement: the node minus the weighted mean of its neighbours."""
    values = [np.concatenate([[1.0], -weights]) for _, _, weights in rows]
    columns = [np.concatenate([[node], near]) for node, near, _ in rows]
    index = [np.full(len(column), row) for row, column in enumerate(columns)]
    if not rows:
        return csr_matrix((0, nodes))
    return coo_matrix(
        (np.concatenate(values), (np.concatenate(index), np.concatenate(columns))), shape=(len(rows), nodes)
    ).tocsr()
