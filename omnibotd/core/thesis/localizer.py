"""Localisation by the thesis: the winning unit's bucket, and in it the most alike sub-node (§6.3.2)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.thesis.links import THRESHOLD, similarity_variance
from omnibotd.core.thesis.responses import Buckets, Classifier, unpack
from omnibotd.core.thesis.vector import Perceiver
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# m: a node this far away is another place, for the margin that PlaceEstimate tells.
_ELSEWHERE = 0.5
# m: spread told while no heading is known.
_UNKNOWN = 10.0


class ThesisLocalizer:
    """Knows one map. Each frame stands for itself; only the compass remembers.

    The thesis has no test for being lost: confidence is 1 for whatever node is the most alike, and 0 only before the
    compass tiles were first seen.
    """

    dirty = None  # it never finds out

    def __init__(self, topo_map: TopoMap, camera: CameraModel) -> None:
        """MapError where the map is of another method."""
        self._responses = unpack(topo_map)
        self._classify = Classifier(topo_map.codebook)
        self._buckets = Buckets(topo_map.units, math.isqrt(len(topo_map.codebook)))
        self._positions = topo_map.poses[:, :2].astype(np.float64)
        self._threshold = topo_map.statistics[THRESHOLD]
        self._perceiver = Perceiver(camera)

    def reset(self) -> None:
        """Forget the compass heading."""
        self._perceiver.reset()

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        """The node most alike, with the compass's heading. FrameError where the frame can't be used."""
        perception = self._perceiver.perceive(frame, odom_from_base)
        if perception is None:
            return PlaceEstimate(frame.stamp, odom_from_base, Pose2D(), 0.0, _UNKNOWN, -1.0, 0.0, -1)
        response = self._classify(perception.vector)
        nodes = self._buckets.near(int(response.argmin()))
        differences = np.linalg.norm(self._responses[nodes] - response, axis=1)
        node = int(nodes[differences.argmin()])
        x, y = (float(value) for value in self._positions[node])
        score, margin = self._compared(response, nodes, node)
        return PlaceEstimate(
            stamp=frame.stamp,
            odom_from_base=odom_from_base,
            map_from_base=Pose2D(x, y, perception.heading.yaw),
            confidence=1.0,
            sigma=math.sqrt(float(similarity_variance(float(differences.min()), self._threshold))),
            score=score,
            margin=margin,
            node=node,
        )

    def _compared(self, response: NDArray[np.float32], nodes: NDArray[np.intp], node: int) -> tuple[float, float]:
        """Correlation of responses with this node's, and its lead over the best sub-node elsewhere (or -1)."""
        alike = _correlations(response, self._responses[nodes])
        score = float(alike[np.searchsorted(nodes, node)])
        apart = np.hypot(*(self._positions[nodes] - self._positions[node]).T)
        return score, score - float(alike[apart > _ELSEWHERE].max(initial=-1.0))


def _correlations(one: NDArray[np.float32], many: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) Pearson correlations of (u,) with each row of (n, u)."""
    one, many = one - one.mean(), many - many.mean(1, keepdims=True)
    norms = np.linalg.norm(many, axis=1) * np.linalg.norm(one)
    return np.asarray(many @ one / np.maximum(norms, 1e-9), np.float32)
