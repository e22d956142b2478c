"""Headings and positions relaxed together: what a path looks like from above also says which way it was headed.

Gauss-Newton on SE(2) over odometry, turns seen, revisits, and measured positions; from a start that is nearly right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, coo_matrix, csr_matrix, diags, hstack, vstack

from omnibotd.core.mapping.links import PathLinker
from omnibotd.core.mapping.relaxation import Differences, Floats, relaxed

# Odometry's standard deviations, fixed and per metre: along the step, and across it (wheels don't slip sideways).
_ALONG, _ALONG_PER_METRE, _ACROSS, _ACROSS_PER_METRE = 0.003, 0.05, 0.002, 0.02
# Regression errors repeat between neighbours: the least standard deviations (m, rad) a measurement is given.
_SIGMA, _YAW_SIGMA = 0.03, 0.02
# Links without an offset only hold what regression can't reach: loosen them.
_REVISIT_LOOSENED = 3.0
_STEPS, _ROUNDS = 2, 4


@dataclass(frozen=True, slots=True)
class Measured:
    """A node's `offset` (m) from the weighted mean of its neighbours (k,), and its `turn` from its present heading."""

    node: int
    near: NDArray[np.intp]
    weights: Floats
    offset: tuple[float, float]
    turn: float


def relax_together(poses: Floats, linker: PathLinker, measured: list[Measured]) -> Floats:
    """(N, 3) poses; those that the linker holds stay."""
    poses = poses.copy()
    for step in range(_STEPS):
        poses[linker.held :] += _correction(poses, linker, measured, turned=step > 0)
    return poses


def _correction(poses: Floats, linker: PathLinker, measured: list[Measured], turned: bool) -> Floats:
    """(N - held, 3)."""
    nodes, held = len(poses), linker.held
    odometry, odometry_values, odometry_sigma = _odometry(poses, linker)
    turns, revisits = linker.turns(nodes), linker.links.revisits()
    mean = _relative_to_neighbours(measured, nodes)
    free_mean, revisit_rows = mean[:, held:], revisits.rows(nodes, held)
    blank, free = csr_matrix, nodes - held
    rows = vstack(
        [
            odometry,
            hstack([block_diag([revisit_rows] * 2), blank((2 * len(revisits), free))]),
            hstack([block_diag([free_mean] * 2), blank((2 * len(measured), free))]),
            hstack([blank((len(turns), 2 * free)), turns.rows(nodes, held)]),
            hstack([blank((len(measured), 2 * free)), free_mean]),
        ]
    ).tocsr()
    offsets = np.array([m.offset for m in measured]).reshape(-1, 2)
    swing = turns.misfit(poses[:, 2])
    # The measured turns were taken from the headings of before: the first step has used them up.
    turn = np.zeros(len(measured)) if turned else np.array([m.turn for m in measured])
    values = np.concatenate(
        [
            odometry_values,
            revisits.misfit(poses[:, :2]).T.ravel(),
            (offsets - mean @ poses[:, :2]).T.ravel(),
            np.arctan2(np.sin(swing), np.cos(swing)),
            turn,
        ]
    )
    sigma = np.concatenate(
        [
            odometry_sigma,
            np.tile(_REVISIT_LOOSENED * revisits.sigma, 2),
            np.full(2 * len(measured), _SIGMA),
            turns.sigma,
            np.full(len(measured), _YAW_SIGMA),
        ]
    )
    result = relaxed(rows, values[:, None], sigma, len(odometry_values), rounds=_ROUNDS)[:, 0]
    return result.reshape(3, free).T


def _odometry(poses: Floats, linker: PathLinker) -> tuple[csr_matrix, Floats, Floats]:
    """Rows (2 S, 3 (N - held)), values and sigmas of the S steps: along and across the heading each started with."""
    nodes, held = len(poses), linker.held
    node = np.arange(linker.known, nodes - 1)
    steps, row = linker.steps[node + 1], np.arange(len(node))
    unit = Differences(node, node + 1, np.zeros(len(node)), np.ones(len(node))).rows(nodes, held)
    turning = node >= held
    shape = (len(node), nodes - held)
    start = csr_matrix((np.ones(int(turning.sum())), (row[turning], node[turning] - held)), shape=shape)
    c, s = np.cos(poses[node, 2]), np.sin(poses[node, 2])
    dx, dy = (poses[node + 1, :2] - poses[node, :2]).T
    along, across = c * dx + s * dy, -s * dx + c * dy
    rows = vstack(
        [
            hstack([diags(c) @ unit, diags(s) @ unit, diags(across) @ start]),
            hstack([diags(-s) @ unit, diags(c) @ unit, diags(-along) @ start]),
        ]
    )
    length = np.hypot(steps[:, 0], steps[:, 1])
    sigma = [_ALONG + _ALONG_PER_METRE * length, _ACROSS + _ACROSS_PER_METRE * length]
    return rows.tocsr(), np.concatenate([steps[:, 0] - along, steps[:, 1] - across]), np.concatenate(sigma)


def _relative_to_neighbours(measured: list[Measured], nodes: int) -> csr_matrix:
    """One row a measurement: the node minus the weighted mean of its neighbours."""
    if not measured:
        return csr_matrix((0, nodes))
    values = np.concatenate([np.concatenate([[1.0], -m.weights]) for m in measured])
    columns = np.concatenate([np.concatenate([[m.node], m.near]) for m in measured])
    index = np.repeat(np.arange(len(measured)), [1 + len(m.near) for m in measured])
    return coo_matrix((values, (index, columns)), shape=(len(measured), nodes)).tocsr()
