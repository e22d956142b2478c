"""Localisation: a frame and odometry in, a pose in the map and the belief in it out (thesis §6.3.2, and more).

view -> spectrum -> SOM buckets -> 20 candidates (in doubt 60, and the next 60 of all nodes) and the nodes near the
likeliest poses -> circular correlation -> hypotheses carried by odometry -> regression of the likeliest -> trust ->
confidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.mapping import regression, snapshots
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation import likeness
from omnibotd.core.navigation.hypotheses import Hypotheses
from omnibotd.core.navigation.node_index import NodeIndex
from omnibotd.core.navigation.sight import Sight, covered, expected_score, ramp
from omnibotd.core.navigation.trust import Trust, calibrated
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.descriptor import Descriptor, Harmonics, correlate, harmonics, smoothed
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.lens_dirt import LensDirt
from omnibotd.core.vision.view import View

Floats = NDArray[np.float64]

# Below this correlation nothing was recognised: such a frame moves no hypothesis.
_RECOGNISED = 0.25
# Candidates this much worse than the best start no hypothesis of their own.
_WORTH_PROPOSING = 0.15
# Correlation falls with the distance to a node by this share of what 95 of 100 stay below; allowed for up to so much.
_USUAL_SHARE, _MOST_ALLOWED = 0.6, 0.4
# Log odds against a correction of any size: the robot may have been pushed.
_MOST_STRAIN = 4.0
# Far from the nodes a pose can't be refuted, but it shall not be kept for ever beside one that fits.
_UNKNOWN_WORSE = 0.005
# Hypotheses registered in a frame (under a usual ceiling there is one), and log weight from which one is worth it.
_RIVALS, _HOPELESS = 4, -7.0
# Correlation with the predicted view from which, and up to which, a registration is taken for what it says of itself.
_FIRM = (0.7, 0.9)
# Nodes looked up by their spectra, 20 us each: while sure, and while trust is below _DOUBT. As many more are then taken
# in turn, for in another light spectra change more than views do.
_TRACKING, _SEARCHING, _DOUBT = 20, 60, 0.5
# Trust from which a pose may be carried where no node is near to speak against it.
_EARNED = 0.05
# Nodes round the likeliest poses are always compared, whatever the SOM says: tracking survives a change of light.
_TRACKED, _LOCAL, _LOCAL_RADIUS = 3, 5, 0.4
# Frames this near together (m) show nearly the same, turned as odometry says (rad); correlating less, or at another
# angle, the robot was carried or its lens covered.
_SAME_VIEW, _SAME_HEADING, _SAME_VIEW_WITHIN = 0.4, 0.3, 0.2
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
# A node so much alike is farther off than its likeness allows beyond its usual reach times this, and these metres.
_ALIKE, _TOO_FAR, _NODE_SLACK = 0.6, 1.2, 0.05
# Standard deviation (m) of a pose taken over from a node at no distance.
_NODE_SIGMA = 0.02
# Poses between nodes match other places by so much better than nodes do.
_IMPOSTOR_SPREAD = 0.05
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


@dataclass(frozen=True, slots=True)
class _Fit:
    """How well the view predicted at a pose fits (-1: none can be), the variance that the nodes leave unexplained
    there, the strain of getting there: log odds against so large a correction of what odometry said, and how well
    the rim alone fits."""

    score: float
    unexplained: float
    strain: float = 0.0
    rim: float = math.nan


def _shortfalls(fits: list[_Fit]) -> Floats:
    """How much worse each fits than it should; far from the nodes, where nothing is expected, a little worse than the
    best of the others, and than a right pose in the light of the teaching drive."""
    known = np.array([covered(fit.unexplained) for fit in fits])
    short = np.array([expected_score(fit.unexplained) - fit.score for fit in fits])
    best = float(short[known > 0.5].min(initial=np.inf))
    if math.isinf(best):
        return np.zeros(len(fits))
    return np.asarray(known * short + (1.0 - known) * max(0.0, best + _UNKNOWN_WORSE))


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
        return _follows(query, self.view, step.yaw, _UNCHANGED)


def _follows(query: Harmonics, last: Harmonics, turn: float, likeness: float) -> bool:
    """Whether a view can follow from the last one by that turn (rad), without having moved much."""
    headings, scores = correlate(query, last[None])
    return bool(scores[0] > likeness and abs(wrap(float(headings[0]) - turn)) < _SAME_HEADING)


class Localizer:
    """Tracks the base in one map. Not thread-safe: one update at a time."""

    def __init__(self, topo_map: TopoMap, camera: CameraModel) -> None:
        self._descriptor = Descriptor(camera)
        self._dirt = LensDirt(self._descriptor.seen)
        self._index = NodeIndex(topo_map)
        self._likeness = likeness.measure(self._index)
        self.reset()

    def reset(self) -> None:
        """Forget where the robot was: the next frame is looked up in the whole map."""
        self._hypotheses = Hypotheses()
        self._trust = Trust(self._likeness.chance + _IMPOSTOR_SPREAD)
        self._odom: Pose2D | None = None
        self._last_view: Harmonics | None = None
        self._rest: _Rest | None = None
        self._latest: PlaceEstimate | None = None
        self._tracked: Pose2D | None = None
        self._next_node = 0

    @property
    def dirty(self) -> NDArray[np.bool_]:
        """(RINGS, SECTORS) cells of the view where the lens is dirty."""
        return self._dirt.dirty

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        """Take the next frame and the odometry at its stamp. FrameError where the frame can't be used."""
        texture = self._dirt.without(self._descriptor.texture(frame), odom_from_base)
        view = smoothed(self._descriptor.normalised(texture), snapshots.ORDERS)  # all that nodes have of theirs
        step = self._move(odom_from_base)
        moved = math.hypot(step.x, step.y) + _TURN_WORTH * abs(step.yaw)
        query = harmonics(view)
        if self._latest is not None and self._settled(query, odom_from_base):
            return replace(self._latest, stamp=frame.stamp, odom_from_base=odom_from_base)
        last, self._last_view = self._last_view, query
        continues = last is None or moved > _SAME_VIEW_WITHIN or _follows(query, last, step.yaw, _SAME_VIEW)
        candidates = self._candidates(view, query)
        evidence = _AT_REST + (1.0 - _AT_REST) * (1.0 - math.exp(-moved / _INDEPENDENT))
        if candidates.best >= _RECOGNISED:
            self._weigh(candidates, evidence, continues)
        if not len(self._hypotheses):
            return PlaceEstimate(frame.stamp, odom_from_base, Pose2D(), 0.0, _UNKNOWN, candidates.best, 0.0, -1)
        fit = self._fit(view, candidates, evidence)
        sight = self._judge(candidates, fit, moved, self._correction(step), continues)
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

    def _move(self, odom_from_base: Pose2D) -> Pose2D:
        """Carry the hypotheses along; returns the motion since the last frame."""
        step = self._odom.inverse() @ odom_from_base if self._odom else Pose2D()
        self._odom = odom_from_base
        self._hypotheses.move(step)
        return step

    def _candidates(self, view: View, query: Harmonics) -> _Candidates:
        """By looks, through the SOM; and round the likeliest poses."""
        likeliest = self._hypotheses.poses[:_TRACKED, :2]
        tracked = [self._index.near(float(x), float(y), _LOCAL_RADIUS, _LOCAL) for x, y in likeliest]
        doubt = self._trust.value < _DOUBT
        alike = self._index.alike(Descriptor.spectrum(view), _SEARCHING if doubt else _TRACKING)
        nodes = np.unique(np.concatenate([alike, *tracked, *([self._in_turn()] if doubt else [])]))
        headings, scores = self._index.compare(query, nodes)
        order = np.argsort(-scores, kind="stable")
        poses = np.column_stack([self._index.poses[nodes, :2], headings]).astype(np.float64)
        return _Candidates(poses[order], scores[order].astype(np.float64), nodes[order])

    def _in_turn(self) -> NDArray[np.intp]:
        """The next _SEARCHING of all nodes."""
        nodes = (self._next_node + np.arange(_SEARCHING)) % len(self._index.poses)
        self._next_node = int(nodes[-1]) + 1
        return nodes

    def _weigh(self, seen: _Candidates, evidence: float, continues: bool) -> None:
        """Judge the hypotheses by the candidates, and add new ones."""
        lost_sight = self._trust.broken or not continues
        allowance = np.zeros(len(self._hypotheses)) if lost_sight else self._allowance()
        self._hypotheses.weigh(seen.poses, seen.scores, allowance, evidence)
        worthy = (seen.scores > seen.best - _WORTH_PROPOSING) & (seen.scores >= _RECOGNISED)
        scores = seen.scores[worthy]
        self._hypotheses.propose(seen.poses[worthy], scores, self._node_sigma(scores))

    def _allowance(self) -> Floats:
        """(H,) correlation that each hypothesis loses to the distance of its nearest node; one that was never trusted
        is not spared for having left the map."""
        places = [(float(x), float(y)) for x, y in self._hypotheses.poses[:, :2]]
        distances = np.array([self._index.distance(x, y, _LOCAL_RADIUS) for x, y in places])
        allowance = np.minimum(distances / (_USUAL_SHARE * self._likeness.reach), _MOST_ALLOWED)
        if self._trust.value < _EARNED:
            allowance[distances >= _LOCAL_RADIUS] = 0.0
        return allowance

    def _fit(self, view: View, seen: _Candidates, evidence: float) -> _Fit:
        """Register the likeliest hypotheses, reweigh them by how each fits, and give the fit of the likeliest then."""
        rivals = min(_RIVALS, int((self._hypotheses.log_weights > _HOPELESS).sum()))
        fits = [self._sharpen(view, seen, evidence)]
        fits += [self._regress(view, number, evidence) for number in range(1, rivals)]
        costs = np.array([fit.strain for fit in fits])
        best = fits[self._hypotheses.judge(_shortfalls(fits), costs, evidence)]
        self._trust.shake(best.strain)
        return best

    def _node_sigma(self, score: Any) -> Any:
        """Standard deviation (m) of the place of a view that correlates with a node at `score` (an array, or one)."""
        return _NODE_SIGMA + 0.5 * self._likeness.reach * np.maximum(0.0, 1.0 - score / self._trust.light.share)

    def _sharpen(self, view: View, seen: _Candidates, evidence: float) -> _Fit:
        """Correct the likeliest hypothesis by regression.

        A pose taken over a few decimetres off can predict well enough to be kept for metres, so where a node looks more
        alike than its distance allows, that node is the better start.
        """
        fit = self._regress(view, 0, evidence)
        near = self._beside(seen)
        if near is None or seen.scores[near] < max(fit.score - _WORTH_PROPOSING, _ALIKE):
            return fit
        x, y, yaw = (float(value) for value in seen.poses[near])
        score = float(seen.scores[near])
        if self._hypotheses.pose(0).distance(Pose2D(x, y)) < _NODE_SLACK + _TOO_FAR * self._likeness.distance(score):
            return fit
        self._hypotheses.place(0, Pose2D(x, y, yaw), self._node_sigma(score))
        return replace(self._regress(view, 0, 1.0), strain=_MOST_STRAIN)

    def _beside(self, seen: _Candidates) -> int | None:
        """The best candidate that is about where the likeliest hypothesis is."""
        x, y, yaw = self._hypotheses.poses[0]
        turn = np.abs(np.remainder(seen.poses[:, 2] - yaw + np.pi, 2.0 * np.pi) - np.pi)
        near = np.hypot(seen.poses[:, 0] - x, seen.poses[:, 1] - y) < _LOCAL_RADIUS
        found = np.flatnonzero(near & (turn < _TURN_GATE))
        return int(found[0]) if len(found) else None  # candidates come best first

    def _regress(self, view: View, number: int, evidence: float) -> _Fit:
        """Register one hypothesis with the nodes round about, and put it where it fits."""
        prior, sigma = self._hypotheses.pose(number), float(self._hypotheses.sigmas[number])
        near = self._index.near(prior.x, prior.y, regression.RADIUS, regression.NEIGHBOURS)
        if len(near) < _FEWEST:
            return _Fit(-1.0, 1.0)
        nodes = self._index
        found = regression.refine(view, prior, sigma, nodes.poses[near, :2], nodes.aligned(near), evidence=evidence)
        if found.pose.distance(prior) > _GATE or abs(wrap(found.pose.yaw - prior.yaw)) > _TURN_GATE:
            return _Fit(-1.0, found.unexplained)
        # A poor fit says little about where exactly.
        loose = sigma * (1.0 - ramp(found.score / self._trust.light.share, *_FIRM))
        self._hypotheses.place(number, found.pose, max(found.sigma, _SURE, loose))
        strain = 0.5 * (found.pose.distance(prior) / (sigma + _SURE)) ** 2
        return _Fit(found.score, found.unexplained, min(strain, _MOST_STRAIN), found.rim)

    def _correction(self, step: Pose2D) -> float:
        """How far (m) the tracked pose was moved beyond what odometry says."""
        expected, self._tracked = self._tracked, self._hypotheses.pose(0)
        corrected = self._tracked.distance(expected @ step) if expected is not None else 0.0
        if corrected > _JUMP:
            self._trust.start_again()
        return corrected

    def _judge(self, seen: _Candidates, fit: _Fit, moved: float, corrected: float, continues: bool) -> Sight:
        """What the frame says about the likeliest pose."""
        x, y, _ = (float(value) for value in self._hypotheses.poses[0])
        score = max(fit.score, float(self._hypotheses.supported(seen.poses, seen.scores)[0]))
        apart = np.hypot(seen.poses[:, 0] - x, seen.poses[:, 1] - y)
        # Where all candidates are here, the best elsewhere is no better than the worst of them.
        elsewhere = float(seen.scores[apart > _ELSEWHERE].max(initial=seen.scores.min(initial=1.0)))
        return Sight(score, elsewhere, fit.unexplained, moved, corrected, continues, fit.rim)

    def _estimate(self, stamp: float, odom: Pose2D, seen: _Candidates, sight: Sight) -> PlaceEstimate:
        x, y, yaw = (float(value) for value in self._hypotheses.poses[0])
        sigma = float(self._hypotheses.sigmas[0])
        belief = self._trust.update(sight) * self._hypotheses.share() * _within(sigma)
        nearest = int(np.hypot(seen.poses[:, 0] - x, seen.poses[:, 1] - y).argmin())
        return PlaceEstimate(
            stamp,
            odom,
            Pose2D(x, y, yaw),
            confidence=calibrated(belief, self._likeness.chance),
            sigma=sigma,
            score=sight.score,
            margin=sight.score - sight.elsewhere,
            node=int(seen.nodes[nearest]),
        )


def _within(sigma: float) -> float:
    """Chance that a pose with `sigma` an axis is within the 0.25 m that `confidence` stands for."""
    return 1.0 - math.exp(-(_RIGHT**2) / (2.0 * sigma**2))
