"""Localisation: a frame and odometry in, a pose in the map and the belief in it out (thesis §6.3.2, and what it lacked).

view -> spectrum -> SOM buckets -> 20 candidates -> circular correlation -> hypotheses carried by odometry -> local
regression for the metric pose -> confidence.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping import regression
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.hypotheses import Hypotheses
from omnibotd.core.navigation.node_index import NodeIndex
from omnibotd.core.navigation.trust import Trust
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.descriptor import Descriptor, Harmonics, harmonics
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.view import View

Floats = NDArray[np.float64]

# Below this correlation nothing was recognised: such a frame moves no hypothesis.
_RECOGNISED = 0.4
# Candidates this much worse than the best start no hypothesis of their own.
_WORTH_PROPOSING = 0.15
# Nodes round the likeliest poses are always compared, whatever the SOM says: tracking survives a change of light.
_TRACKED, _LOCAL, _LOCAL_RADIUS = 3, 5, 0.4
# The margin is taken to the best candidate at least this far away (m).
_ELSEWHERE = 0.5
# Frames become independent evidence with motion: e-folding length (m), a turn's worth (m/rad), and what a frame at rest
# counts, so that a kidnapped robot notices within seconds.
_INDEPENDENT, _TURN_WORTH, _AT_REST = 0.15, 0.1, 0.1
# Regression: fewest neighbours, how far it may pull, its standard deviation; that of the best node's own pose.
_FEWEST, _RADIUS, _GATE, _TURN_GATE, _SIGMA, _NODE_SIGMA = 6, 0.45, 0.25, 0.2, 0.04, 0.15
# Regression errors repeat from frame to frame: never believe to be surer than this.
_SURE = 0.02


class Localizer:
    """Tracks the base in one map. Not thread-safe: one update at a time."""

    def __init__(self, topo_map: TopoMap, camera: CameraModel) -> None:
        self._descriptor = Descriptor(camera)
        self._index = NodeIndex(topo_map)
        self.reset()

    def reset(self) -> None:
        """Forget where the robot was: the next frame is looked up in the whole map."""
        self._hypotheses = Hypotheses()
        self._trust = Trust()
        self._odom: Pose2D | None = None

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        """Take the next frame and the odometry at its stamp. FrameError where the frame can't be used."""
        view = self._descriptor.view(frame)
        moved = self._move(odom_from_base)
        poses, scores, nodes = self._candidates(view)
        evidence = _AT_REST + (1.0 - _AT_REST) * (1.0 - math.exp(-moved / _INDEPENDENT))
        if scores.max(initial=-1.0) >= _RECOGNISED:
            self._hypotheses.weigh(poses, scores, evidence)
            self._propose(poses, scores)
        if not len(self._hypotheses):
            return PlaceEstimate(frame.stamp, odom_from_base, Pose2D(), 0.0, math.inf, _best(scores), 0.0, -1)
        self._sharpen(view, poses, scores)
        return self._estimate(frame.stamp, odom_from_base, poses, scores, nodes, moved)

    def _move(self, odom_from_base: Pose2D) -> float:
        """Carry the hypotheses along; returns the motion in metres, turns included."""
        step = self._odom.inverse() @ odom_from_base if self._odom else Pose2D()
        self._odom = odom_from_base
        self._hypotheses.move(step)
        return math.hypot(step.x, step.y) + _TURN_WORTH * abs(step.yaw)

    def _candidates(self, view: View) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Poses (C, 3), scores (C,) and nodes (C,) to be judged, best first: by looks, and near the likeliest poses."""
        query: Harmonics = harmonics(view)
        tracked = [
            self._index.near(float(x), float(y), _LOCAL_RADIUS, _LOCAL) for x, y, _ in self._hypotheses.poses[:_TRACKED]
        ]
        nodes = np.unique(np.concatenate([self._index.alike(Descriptor.spectrum(view)), *tracked]))
        headings, scores = self._index.compare(query, nodes)
        order = np.argsort(-scores, kind="stable")
        poses = np.column_stack([self._index.poses[nodes, :2], headings]).astype(np.float64)
        return poses[order], scores[order].astype(np.float64), nodes[order]

    def _propose(self, poses: Floats, scores: Floats) -> None:
        worthy = (scores > scores[0] - _WORTH_PROPOSING) & (scores >= _RECOGNISED)
        self._hypotheses.propose(poses[worthy], scores[worthy])

    def _sharpen(self, view: View, poses: Floats, scores: Floats) -> None:
        """Correct the likeliest hypothesis by local regression, or where nodes are too few by the nodes that fit."""
        x, y, yaw = (float(value) for value in self._hypotheses.poses[0])
        near = self._index.near(x, y, _RADIUS, regression.NEIGHBOURS)
        if len(near) >= _FEWEST:
            prior, sigma = Pose2D(x, y, yaw), float(self._hypotheses.sigmas[0])
            found = regression.refine(view, prior, sigma, self._index.poses[near, :2], self._index.aligned(near))
            if found.pose.distance(prior) < _GATE and abs(math.remainder(found.pose.yaw - yaw, math.tau)) < _TURN_GATE:
                self._hypotheses.place(0, found.pose, found.sigma)
        self._hypotheses.sigmas[0] = max(self._hypotheses.sigmas[0], _SURE)

    def _estimate(
        self, stamp: float, odom: Pose2D, poses: Floats, scores: Floats, nodes: NDArray[np.intp], moved: float
    ) -> PlaceEstimate:
        x, y, yaw = (float(value) for value in self._hypotheses.poses[0])
        apart = np.hypot(poses[:, 0] - x, poses[:, 1] - y)
        score = float(self._hypotheses.supported(poses, scores)[0])
        rival = float(scores[apart > _ELSEWHERE].max(initial=-1.0))
        margin = score - rival
        trust = self._trust.update(score, _best(scores), margin, moved)
        node = int(nodes[int(apart.argmin())])
        confidence = trust * self._hypotheses.share()
        return PlaceEstimate(
            stamp, odom, Pose2D(x, y, yaw), confidence, float(self._hypotheses.sigmas[0]), score, margin, node
        )


def _best(scores: Floats) -> float:
    return float(scores.max(initial=-1.0))
