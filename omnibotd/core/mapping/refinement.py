"""Sharpening a relaxed path: every node is placed by regression among the nodes of other visits, then relaxed again.

Links between views carry no offset, only "about here"; the regression measures the offset, to about 2 cm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.mapping import regression
from omnibotd.core.mapping.joint import Measured, relax_together
from omnibotd.core.mapping.links import REVISIT, PathLinker
from omnibotd.core.mapping.relaxation import Floats
from omnibotd.core.vision.descriptor import turned
from omnibotd.core.vision.view import View

# Fewer neighbours carry no slope worth having.
_FEWEST = 3
# How good relaxed positions are before (m), and what a measurement must reach to be worth it.
_PRIOR, _USEFUL = 0.1, 0.06
# Over this distance (m) neighbours share a node's error, so it is placed relative to their mean.
_SHARED = 0.15
_ROUNDS = 2


def refined_poses(views: View, linker: PathLinker) -> Floats:
    """(N, 3) poses; hardly other than the linker's own where few places were visited twice. Known nodes stay."""
    poses = linker.poses.copy()
    drive = range(linker.known, len(poses))
    for _ in range(_ROUNDS):
        aligned = turned(views, poses[:, 2])
        measured = [m for m in (_measure(node, views, aligned, poses, linker) for node in drive) if m]
        poses = relax_together(poses, linker, measured)
    return poses


def _measure(node: int, views: View, aligned: View, poses: Floats, linker: PathLinker) -> Measured | None:
    near = _other_visits(node, poses, linker.travelled)
    if len(near) < _FEWEST:
        return None
    x, y, yaw = (float(value) for value in poses[node])
    positions = poses[near, :2].astype(np.float32)
    found = regression.refine(views[node], Pose2D(x, y, yaw), _PRIOR, positions, aligned[near], rounds=1)
    if found.sigma > _USEFUL:
        return None
    weights = np.exp(-((poses[near, :2] - (x, y)) ** 2).sum(1) / (2.0 * _SHARED**2)) + 1e-3
    weights /= weights.sum()
    centre = weights @ poses[near, :2]
    offset = (found.pose.x - float(centre[0]), found.pose.y - float(centre[1]))
    return Measured(node, near, weights, offset, wrap(found.pose.yaw - yaw))


def _other_visits(node: int, poses: Floats, travelled: Floats) -> NDArray[np.intp]:
    apart = np.hypot(poses[:, 0] - poses[node, 0], poses[:, 1] - poses[node, 1])
    apart[np.abs(travelled - travelled[node]) < REVISIT] = np.inf
    near = np.flatnonzero(apart < regression.RADIUS)
    if len(near) <= regression.NEIGHBOURS:
        return near
    return near[np.argpartition(apart[near], regression.NEIGHBOURS)[: regression.NEIGHBOURS]]
