"""Localisation: a frame and odometry in, a pose in the map and the belief in it out (thesis §6.3.2, and more).

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
from omnibotd.core.navigation.trust import Sight, Trust, covered
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
# Support that a hypothesis without any node near is given: what chance look-alikes reach.
_BY_CHANCE = 0.55
# Nodes round the likeliest poses are always compared, whatever the SOM says: tracking survives a change of light.
_TRACKED, _LOCAL, _LOCAL_RADIUS = 3, 5, 0.4
# A likeliest pose this far (m) from where the last one went is another one.
_JUMP = 0.4
# The margin is taken to the best candidate at least this far away (m).
_ELSEWHERE = 0.5
# Frames become independent evidence with motion: e-folding length (m), a turn's worth (m/rad), and what a frame at rest
# counts, so that a kidnapped robot notices within seconds.
_INDEPENDENT, _TURN_WORTH, _AT_REST = 0.15, 0.1, 0.1
# Confidence is the belief that the pose is within this distance (m).
_RIGHT = 0.25
# Regression: fewest neighbours, how far it may pull, its standard deviation; that of the best node's own pose.
_FEWEST, _GATE, _TURN_GATE = 3, 0.25, 0.2
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
        tracked = self._hypotheses.poses[:1].copy()
        if _best(scores) >= _RECOGNISED:
            self._hypotheses.weigh(poses, scores, self._excused(), evidence)
            self._propose(poses, scores)
        if not len(self._hypotheses):
            return PlaceEstimate(frame.stamp, odom_from_base, Pose2D(), 0.0, math.inf, _best(scores), 0.0, -1)
        if len(tracked) and np.hypot(*(self._hypotheses.poses[0] - tracked[0])[:2]) > _JUMP:
            self._trust.start_again()
        fitted = self._sharpen(view)
        return self._estimate(frame.stamp, odom_from_base, fitted, poses, scores, nodes, moved)

    def _excused(self) -> Floats:
        return np.array(
            [_BY_CHANCE * (1.0 - covered(self._index.distance(x, y))) for x, y, _ in self._hypotheses.poses]
        )

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

    def _sharpen(self, view: View) -> float:
        """Correct the likeliest hypothesis by regression; returns how well the view predicted there fits, or -1."""
        x, y, yaw = (float(value) for value in self._hypotheses.poses[0])
        near = self._index.near(x, y, regression.RADIUS, regression.NEIGHBOURS)
        if len(near) < _FEWEST:
            return -1.0
        prior, sigma = Pose2D(x, y, yaw), float(self._hypotheses.sigmas[0])
        found = regression.refine(view, prior, sigma, self._index.poses[near, :2], self._index.aligned(near))
        if found.pose.distance(prior) > _GATE or abs(math.remainder(found.pose.yaw - yaw, math.tau)) > _TURN_GATE:
            return -1.0
        self._hypotheses.place(0, found.pose, max(found.sigma, _SURE))
        return found.score

    def _estimate(
        self,
        stamp: float,
        odom: Pose2D,
        fitted: float,
        poses: Floats,
        scores: Floats,
        nodes: NDArray[np.intp],
        moved: float,
    ) -> PlaceEstimate:
        x, y, yaw = (float(value) for value in self._hypotheses.poses[0])
        apart = np.hypot(poses[:, 0] - x, poses[:, 1] - y)
        score = max(fitted, float(self._hypotheses.supported(poses, scores)[0]))
        elsewhere = float(scores[apart > _ELSEWHERE].max(initial=-1.0))
        sigma = float(self._hypotheses.sigmas[0])
        trust = self._trust.update(Sight(score, elsewhere, self._index.distance(x, y), moved))
        return PlaceEstimate(
            stamp,
            odom,
            Pose2D(x, y, yaw),
            confidence=trust * self._hypotheses.share() * _within(sigma),
            sigma=sigma,
            score=score,
            margin=score - elsewhere,
            node=int(nodes[int(apart.argmin())]),
        )


def _best(scores: Floats) -> float:
    return float(scores.max(initial=-1.0))


def _within(sigma: float) -> float:
    """Chance that a pose with `sigma` an axis is within the 0.25 m that `confidence` stands for."""
    return 1.0 - math.exp(-(_RIGHT**2) / (2.0 * sigma**2))
