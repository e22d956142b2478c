"""Localisation: a frame and odometry in, a pose in the map and the belief in it out (thesis §6.3.2, and more).

view -> spectrum -> SOM buckets -> 20 candidates -> circular correlation -> hypotheses carried by odometry -> local
regression for the metric pose -> confidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
from omnibotd.core.vision.descriptor import Descriptor, Harmonics, correlate, harmonics
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
# Frames this near together (m) show nearly the same; correlating less, the robot was carried or its lens covered.
_SAME_VIEW, _SAME_VIEW_WITHIN = 0.4, 0.2
# A likeliest pose this far (m) from where the last one went is another one.
_JUMP = 0.4
# The margin is taken to the best candidate at least this far away (m).
_ELSEWHERE = 0.5
# Frames become independent evidence with motion: e-folding length (m), a turn's worth (m/rad), and what a frame at rest
# counts, so that a kidnapped robot notices within seconds.
_INDEPENDENT, _TURN_WORTH, _AT_REST = 0.15, 0.1, 0.1
# Confidence is the belief that the pose is within this distance (m).
_RIGHT = 0.25
# Regression: fewest neighbours, how far it may pull (m, rad).
_FEWEST, _GATE, _TURN_GATE = 3, 0.25, 0.2
# Spread reported (m) where nothing has been recognised yet.
_UNKNOWN = 10.0
# A robot that stands sees the same again and again: after so many frames nothing is left to learn, and to go on would
# turn one view's error into certainty. It stands as long as odometry (m, rad) and view stay the same.
_SETTLED, _STOOD, _STOOD_TURN, _UNCHANGED = 5, 0.002, 0.005, 0.85
# Regression errors repeat from frame to frame: never believe to be surer than this.
_SURE = 0.02


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Poses (C, 3) at which the view would fit a node, correlations (C,) and nodes (C,), best first."""

    poses: Floats
    scores: Floats
    nodes: NDArray[np.intp]

    @property
    def best(self) -> float:
        return float(self.scores.max(initial=-1.0))


@dataclass
class _Rest:
    """A stretch of standing still: the view and the odometry at its beginning."""

    view: Harmonics
    odom_from_base: Pose2D
    frames: int = 0

    def lasts(self, query: Harmonics, odom_from_base: Pose2D) -> bool:
        step = self.odom_from_base.inverse() @ odom_from_base
        if math.hypot(step.x, step.y) > _STOOD or abs(step.yaw) > _STOOD_TURN:
            return False
        return bool(correlate(query, self.view[None])[1][0] > _UNCHANGED)


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
        self._last_view: Harmonics | None = None
        self._rest: _Rest | None = None
        self._latest: PlaceEstimate | None = None

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        """Take the next frame and the odometry at its stamp. FrameError where the frame can't be used."""
        view = self._descriptor.view(frame)
        moved = self._move(odom_from_base)
        query = harmonics(view)
        if self._latest is not None and self._settled(query, odom_from_base):
            return replace(self._latest, stamp=frame.stamp, odom_from_base=odom_from_base)
        continues = self._continues(query, moved)
        candidates = self._candidates(view, query)
        if candidates.best >= _RECOGNISED:
            self._weigh(candidates, moved, continues)
        if not len(self._hypotheses):
            return PlaceEstimate(frame.stamp, odom_from_base, Pose2D(), 0.0, _UNKNOWN, candidates.best, 0.0, -1)
        fitted = self._sharpen(view)
        sight = self._judge(candidates, fitted, moved, continues)
        self._latest = self._estimate(frame.stamp, odom_from_base, candidates, sight)
        return self._latest

    def _settled(self, query: Harmonics, odom_from_base: Pose2D) -> bool:
        """Whether the base has stood under one view for long enough."""
        rest = self._rest
        if rest is None or not rest.lasts(query, odom_from_base):
            self._rest = _Rest(query, odom_from_base)
            return False
        rest.frames += 1
        return rest.frames > _SETTLED

    def _move(self, odom_from_base: Pose2D) -> float:
        """Carry the hypotheses along; returns the motion in metres, turns included."""
        step = self._odom.inverse() @ odom_from_base if self._odom else Pose2D()
        self._odom = odom_from_base
        self._hypotheses.move(step)
        return math.hypot(step.x, step.y) + _TURN_WORTH * abs(step.yaw)

    def _continues(self, query: Harmonics, moved: float) -> bool:
        """Whether this view can follow from the last one, after so little motion."""
        last, self._last_view = self._last_view, query
        if last is None or moved > _SAME_VIEW_WITHIN:
            return True
        return bool(correlate(query, last[None])[1][0] > _SAME_VIEW)

    def _candidates(self, view: View, query: Harmonics) -> _Candidates:
        """By looks, through the SOM; and round the likeliest poses."""
        likeliest = self._hypotheses.poses[:_TRACKED, :2]
        tracked = [self._index.near(float(x), float(y), _LOCAL_RADIUS, _LOCAL) for x, y in likeliest]
        nodes = np.unique(np.concatenate([self._index.alike(Descriptor.spectrum(view)), *tracked]))
        headings, scores = self._index.compare(query, nodes)
        order = np.argsort(-scores, kind="stable")
        poses = np.column_stack([self._index.poses[nodes, :2], headings]).astype(np.float64)
        return _Candidates(poses[order], scores[order].astype(np.float64), nodes[order])

    def _weigh(self, seen: _Candidates, moved: float, continues: bool) -> None:
        """Judge the hypotheses by the candidates, add new ones, and notice when another becomes the likeliest."""
        tracked = self._hypotheses.poses[:1].copy()
        evidence = _AT_REST + (1.0 - _AT_REST) * (1.0 - math.exp(-moved / _INDEPENDENT))
        lost_sight = self._trust.broken or not continues
        excused = np.zeros(len(self._hypotheses)) if lost_sight else self._excused()
        self._hypotheses.weigh(seen.poses, seen.scores, excused, evidence)
        worthy = (seen.scores > seen.best - _WORTH_PROPOSING) & (seen.scores >= _RECOGNISED)
        self._hypotheses.propose(seen.poses[worthy], seen.scores[worthy])
        if len(tracked) and np.hypot(*(self._hypotheses.poses[0] - tracked[0])[:2]) > _JUMP:
            self._trust.start_again()

    def _excused(self) -> Floats:
        """(H,) support each hypothesis is granted unseen, for want of nodes."""
        distances = [self._index.distance(float(x), float(y)) for x, y in self._hypotheses.poses[:, :2]]
        return np.array([_BY_CHANCE * (1.0 - covered(distance)) for distance in distances])

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

    def _judge(self, seen: _Candidates, fitted: float, moved: float, continues: bool) -> Sight:
        """What the frame says about the likeliest pose."""
        x, y, _ = (float(value) for value in self._hypotheses.poses[0])
        score = max(fitted, float(self._hypotheses.supported(seen.poses, seen.scores)[0]))
        apart = np.hypot(seen.poses[:, 0] - x, seen.poses[:, 1] - y)
        elsewhere = float(seen.scores[apart > _ELSEWHERE].max(initial=-1.0))
        return Sight(score, elsewhere, self._index.distance(x, y), moved, continues)

    def _estimate(self, stamp: float, odom: Pose2D, seen: _Candidates, sight: Sight) -> PlaceEstimate:
        x, y, yaw = (float(value) for value in self._hypotheses.poses[0])
        sigma = float(self._hypotheses.sigmas[0])
        nearest = int(np.hypot(seen.poses[:, 0] - x, seen.poses[:, 1] - y).argmin())
        return PlaceEstimate(
            stamp,
            odom,
            Pose2D(x, y, yaw),
            confidence=self._trust.update(sight) * self._hypotheses.share() * _within(sigma),
            sigma=sigma,
            score=sight.score,
            margin=sight.score - sight.elsewhere,
            node=int(seen.nodes[nearest]),
        )


def _within(sigma: float) -> float:
    """Chance that a pose with `sigma` an axis is within the 0.25 m that `confidence` stands for."""
    return 1.0 - math.exp(-(_RIGHT**2) / (2.0 * sigma**2))
