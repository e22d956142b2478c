"""Links found while driving: each new node is compared with the old ones that odometry says are near (alias-safe).

Comparing only near the predicted pose keeps look-alikes elsewhere out of the map; relaxing every few metres keeps the
prediction near. For the training process only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from omnibotd.core.mapping.relaxation import Differences, Floats, joined, relax_headings, relax_positions, relaxed
from omnibotd.core.vision.descriptor import Harmonics, correlate

# A node this much farther along the path counts as another visit; anything nearer shares its odometry error.
REVISIT = 1.0
# Half the side of the square searched round the predicted pose: drift since the last relaxation, and then some.
_GATE = 0.6
_HEADING_GATE = 0.35
# Of the nodes inside the gate the most similar by spectrum are correlated; the others are farther off than these.
_COMPARED = 40
# Correlation from which two views count as the same place seen again (8 cm apart: about 0.8), and how many are kept.
_SAME_PLACE, _KEPT, _WITHIN = 0.6, 4, 0.15
# The same for nodes of an older map: theirs is a snapshot, which lost some detail, maybe of another light.
_SAME_AS_KNOWN = 0.5
# Turns against these earlier nodes are measured too: the camera is a better gyroscope than the wheels.
_COMPASS_LAGS = np.array([1, 2, 3, 5, 8])
_COMPASS_RANGE, _COMPASS_SCORE = 0.4, 0.65
# Standard deviations grow as the correlation falls from 1, because the distance between two views does: of a turn (rad;
# translation leans on it), and of a revisit (m an axis, its true offset being unknown).
_TURN_SIGMA, _TURN_SIGMA_LOSS, _PLACE_SIGMA, _PLACE_SIGMA_LOSS = 0.01, 0.12, 0.02, 0.4
# How far a turn by odometry is expected to be off a metre driven (rad), and a radian turned: wheels 2 % unequal, and a
# wheel separation known to 5 %.
_WHEELS = np.array([0.1, 0.05])
# Less than that is the compass' own bias: translation leans on it, by 0.01 of either on real frames.
_COMPASS_BIAS = 0.02
# Nodes between relaxations: some five metres of driving.
_BATCH = 60


@dataclass
class Links:
    """Visual measurements: node pairs, heading of `later` minus that of `earlier`, score; `place` marks revisits."""

    earlier: list[int] = field(default_factory=list)
    later: list[int] = field(default_factory=list)
    turn: list[float] = field(default_factory=list)
    score: list[float] = field(default_factory=list)
    place: list[bool] = field(default_factory=list)

    def add(
        self,
        later: int,
        earlier: NDArray[np.intp],
        turn: NDArray[np.float32],
        score: NDArray[np.float32],
        place: bool,
    ) -> None:
        self.later += [later] * len(earlier)
        self.earlier += [int(node) for node in earlier]
        self.turn += [float(value) for value in turn]
        self.score += [float(value) for value in score]
        self.place += [place] * len(earlier)

    def extend(self, others: Links) -> None:
        self.earlier += others.earlier
        self.later += others.later
        self.turn += others.turn
        self.score += others.score
        self.place += others.place

    def moved(self, by: int) -> Links:
        """The same links between nodes whose numbers are larger."""
        earlier, later = [node + by for node in self.earlier], [node + by for node in self.later]
        return Links(earlier, later, self.turn.copy(), self.score.copy(), self.place.copy())

    def turns(self) -> Differences:
        first, second = np.array(self.earlier, np.intp), np.array(self.later, np.intp)
        sigma = _TURN_SIGMA + _TURN_SIGMA_LOSS * (1.0 - np.array(self.score))
        return Differences(first, second, np.array(self.turn), sigma)

    def revisits(self) -> Differences:
        place = np.array(self.place, bool)
        first, second = np.array(self.earlier, np.intp)[place], np.array(self.later, np.intp)[place]
        sigma = _PLACE_SIGMA + _PLACE_SIGMA_LOSS * (1.0 - np.array(self.score)[place])
        return Differences(first, second, np.zeros((len(first), 2)), sigma)


class PathLinker:
    """Places the nodes of one teaching drive, in order, and links them to earlier ones.

    `steps` (N, 3) are odometry poses of each node in the one before (row 0 unused). The first `known` nodes are those
    of an older map, whose poses stay; their steps are unused.
    """

    def __init__(self, steps: Floats, views: Harmonics, spectra: NDArray[np.float32], known: int = 0) -> None:
        self.steps, self.views, self.spectra, self.known = steps.copy(), views, spectra, known
        self.held = max(known, 1)  # the first node of all is the origin
        self.travelled = np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))
        self.travelled[:known] = -np.inf
        self.poses = np.zeros((len(steps), 3))
        self.links = Links()

    def run(self, progress: Callable[[float], None]) -> None:
        """Place and link every node of a drive on its own, relaxing as it goes and thoroughly at the end."""
        nodes = len(self.steps)
        compass = [self._turns_seen(node) for node in range(nodes)]
        self._calibrate(compass)
        for node in range(1, nodes):
            self._place(node)
            self.links.extend(compass[node])
            self._revisit(
                node, int(np.searchsorted(self.travelled[:node], self.travelled[node] - REVISIT)), _SAME_PLACE
            )
            if node % _BATCH == 0:
                self.relax(node + 1, rounds=2)
                progress(node / nodes)
        self.relax(nodes, rounds=6)

    def revisit_known(self) -> None:
        """Link the drive's nodes, placed already, to the known ones near by, and relax."""
        for node in range(self.known, len(self.steps)):
            self._revisit(node, self.known, _SAME_AS_KNOWN)
        self.relax(len(self.steps), rounds=6)

    def relax(self, nodes: int, rounds: int) -> None:
        """Headings, then positions, of the first `nodes` nodes from odometry and all links so far."""
        headings = relax_headings(self.turns(nodes), self.poses[:nodes, 2], rounds, self.held)
        odometry = odometry_offsets(self.steps[:nodes], headings, self.known)
        offsets = joined([odometry, self.links.revisits()])
        self.poses[:nodes, :2] = relax_positions(offsets, self.poses[:nodes, :2], len(odometry), rounds, self.held)
        self.poses[:nodes, 2] = headings

    def turns(self, nodes: int) -> Differences:
        """Turns between the first `nodes` nodes as odometry and all links so far have them."""
        return joined([_odometry_turns(self.steps[:nodes], self.known), self.links.turns()])

    def _place(self, node: int) -> None:
        """Predict from the node before, by odometry."""
        x, y, yaw = self.poses[node - 1]
        dx, dy, turn = self.steps[node]
        c, s = np.cos(yaw), np.sin(yaw)
        self.poses[node] = x + c * dx - s * dy, y + s * dx + c * dy, yaw + turn

    def _turns_seen(self, node: int) -> Links:
        """Turns since the nodes just before, by compass."""
        earlier = node - _COMPASS_LAGS[node >= _COMPASS_LAGS]
        near = earlier[self.travelled[node] - self.travelled[earlier] < _COMPASS_RANGE]
        turn, score = correlate(self.views[node], self.views[near])
        # Half-way between square lamps a view looks much the same a quarter turn round, which no odometry is wrong by.
        off = turn - [self.steps[first + 1 : node + 1, 2].sum() for first in near]
        likely = np.abs(np.arctan2(np.sin(off), np.cos(off))) < _HEADING_GATE
        good, links = likely & (score > _COMPASS_SCORE), Links()
        links.add(node, near[good], turn[good], score[good], place=False)
        return links

    def _calibrate(self, compass: list[Links]) -> None:
        """Take out of the steps what wheels of unequal size or a wrong distance between them add to every turn."""
        seen = Links()
        for links in compass:
            seen.extend(links)
        turns, driven = seen.turns(), np.cumsum(self.steps[:, [0, 2]], axis=0)
        misfit = turns.misfit(driven[:, 1])
        rows = np.concatenate([np.eye(2), driven[turns.second] - driven[turns.first]])
        values = np.concatenate([np.zeros(2), np.arctan2(np.sin(misfit), np.cos(misfit))])
        sigma = np.concatenate([_WHEELS, turns.sigma])
        off = relaxed(csr_matrix(rows), values[:, None], sigma, trusted=2)[:, 0]
        self.steps[:, 2] += self.steps[:, [0, 2]] @ np.where(np.abs(off) > _COMPASS_BIAS, off, 0.0)

    def _revisit(self, node: int, old: int, least: float) -> None:
        """Link to those of the first `old` nodes that are near and correlate by more than `least`."""
        near = np.flatnonzero((np.abs(self.poses[:old, :2] - self.poses[node, :2]) < _GATE).all(1))
        if len(near) > _COMPARED:
            unlike = ((self.spectra[near] - self.spectra[node]) ** 2).sum(1)
            near = near[np.argpartition(unlike, _COMPARED)[:_COMPARED]]
        if not len(near):
            return
        turn, score = correlate(self.views[node], self.views[near])
        off = turn - (self.poses[node, 2] - self.poses[near, 2])
        good = (np.abs(np.arctan2(np.sin(off), np.cos(off))) < _HEADING_GATE) & (score > least)
        near, turn, score = near[good], turn[good], score[good]
        if not len(near):
            return
        best = np.argsort(-score)[:_KEPT]
        best = best[score[best] > score[best[0]] - _WITHIN]
        self.links.add(node, near[best], turn[best], score[best], place=True)
        self._correct(node, int(near[best[0]]), float(turn[best[0]]))

    def _correct(self, node: int, seen_again: int, turn: float) -> None:
        """Half-way to the revisited node at once: keeps the prediction sharp until the next relaxation."""
        excess = turn + self.poses[seen_again, 2] - self.poses[node, 2]
        self.poses[node, 2] += 0.5 * np.arctan2(np.sin(excess), np.cos(excess))
        self.poses[node, :2] += 0.5 * (self.poses[seen_again, :2] - self.poses[node, :2])


def _odometry_turns(steps: Floats, known: int) -> Differences:
    """Wheels: 0.2 degrees of jitter, 3 % of the turn, and 1.7 degrees a metre of path."""
    node = np.arange(known + 1, len(steps))
    length = np.hypot(steps[node, 0], steps[node, 1])
    sigma = 0.004 + 0.03 * np.abs(steps[node, 2]) + 0.03 * length
    return Differences(node - 1, node, steps[node, 2], sigma)


def odometry_offsets(steps: Floats, headings: Floats, known: int = 0) -> Differences:
    """Steps turned into map axes; 5 mm and 5 % of the distance."""
    node = np.arange(known + 1, len(steps))
    c, s = np.cos(headings[node - 1]), np.sin(headings[node - 1])
    dx, dy = steps[node, 0], steps[node, 1]
    offset = np.stack([c * dx - s * dy, s * dx + c * dy], 1)
    return Differences(node - 1, node, offset, 0.005 + 0.05 * np.hypot(dx, dy))
