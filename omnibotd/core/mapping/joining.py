"""Where a new drive lies in an old map: look-ups of many of its nodes vote, and only a clear winner counts.

A look-alike elsewhere convinces a node or two; over a stretch of driving only the right place fits every node. Under a
periodic ceiling several may, and then the drive is not joined.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import TrainingError
from omnibotd.core.mapping.relaxation import Floats, Ints
from omnibotd.core.vision.descriptor import Harmonics, correlate

Spectra = NDArray[np.float32]

# Nodes looked up at most, evenly spread: more agree no better.
_PROBES = 1000
# Old nodes correlated with a probe, the most similar by spectrum; how many of them may vote, and from what correlation.
_LOOKED_UP, _VOTING, _CREDIBLE = 60, 10, 0.5
# Probes that vote together: over so short a stretch of driving odometry and compass hardly drift.
_WINDOW = 40
# Two poses agree within a node's spacing and the drift of a window (m, rad) ...
_NEAR, _NEAR_TURN = 0.35, 0.2
# ... and those of two windows within the drift of a whole drive.
_SAME, _SAME_TURN = 0.75, 0.3
# Different poses a window may vote for.
_CHOICES = 4
# What the winner must have: so many probes recognised, and a runner-up of at most this share of its votes.
_FEWEST, _RUNNER_UP = 15, 0.7


@dataclass(frozen=True, slots=True)
class Nodes:
    """Poses (N, 3), views and spectra (N, F) of the nodes of a map, or of a drive in a frame of its own."""

    poses: Floats
    views: Harmonics
    spectra: Spectra


@dataclass(frozen=True, slots=True)
class Sightings:
    """Drive nodes (C,) that look like old nodes (C,): turn (C,), correlation (C,), and `poses` (C, 3) in the old map,
    as if they had been taken at the old nodes."""

    node: Ints
    old: Ints
    turn: NDArray[np.float32]
    score: NDArray[np.float32]
    poses: Floats

    def chosen(self, which: NDArray[np.bool_]) -> Sightings:
        return Sightings(self.node[which], self.old[which], self.turn[which], self.score[which], self.poses[which])


@dataclass(frozen=True, slots=True)
class _Votes:
    """V opinions of windows: where the drive's frame lies in the map (V, 3), votes for that (V,), and whose it is."""

    map_from_drive: Floats
    votes: Floats
    window: Ints


def join(drive: Nodes, old: Nodes, progress: Callable[[float], None]) -> tuple[Floats, Sightings]:
    """Poses (N, 3) of the drive's nodes in the old map, good to some decimetres, and the sightings that agree on them.

    TrainingError where too little was recognised, or nothing clearly.
    """
    stride = -(-len(drive.poses) // _PROBES)
    probes = np.arange(0, len(drive.poses), stride)
    seen = _look_up(drive, old, probes, progress)
    span = stride * _WINDOW
    windows = [seen.chosen(seen.node // span == k) for k in range(int(probes[-1]) // span + 1)]
    opinions = _joined([_opinions(drive.poses, window, k) for k, window in enumerate(windows)])
    agreed = _elected(opinions, drive.poses[np.minimum(opinions.window * span + span // 2, len(drive.poses) - 1)])
    chosen = [windows[k].chosen(_agreeing(drive.poses, windows[k], pose)) for k, pose in agreed.items()]
    recognised = len(np.unique(np.concatenate([np.zeros(0, np.intp), *(part.node for part in chosen)])))
    if recognised < _FEWEST:
        raise TrainingError(
            f"only {recognised} of {len(probes)} places of the drive were recognised in the map, {_FEWEST} are needed: "
            "drive for half a minute where the map was taught and in a light it knows, or start a new map with --fresh"
        )
    nearest = np.array(list(agreed))[np.abs(np.arange(len(windows))[:, None] - list(agreed)).argmin(1)]
    transforms = np.array([agreed[int(k)] for k in nearest])
    return _compose(transforms[np.arange(len(drive.poses)) // span], drive.poses), _merged(chosen)


def _look_up(drive: Nodes, old: Nodes, probes: Ints, progress: Callable[[float], None]) -> Sightings:
    """The best look-alikes of every probe anywhere in the old map."""
    squares, parts = (old.spectra**2).sum(1), []
    for count, probe in enumerate(probes):
        unlike = squares - 2.0 * (old.spectra @ drive.spectra[probe])
        asked = min(_LOOKED_UP, len(unlike) - 1)
        near = np.argpartition(unlike, asked)[: asked + 1]
        turn, score = correlate(drive.views[probe], old.views[near])
        best = np.argsort(-score, kind="stable")[:_VOTING]
        best = best[score[best] > _CREDIBLE]
        poses = old.poses[near[best]] + np.column_stack([np.zeros((len(best), 2)), turn[best]])
        parts.append(Sightings(np.full(len(best), probe), near[best], turn[best], score[best], poses))
        if count % 50 == 0:
            progress(count / len(probes))
    return _merged(parts)


def _merged(parts: list[Sightings]) -> Sightings:
    columns = ("node", "old", "turn", "score", "poses")
    return Sightings(*(np.concatenate([getattr(part, column) for part in parts]) for column in columns))


def _opinions(drive_poses: Floats, window: Sightings, number: int) -> _Votes:
    """The poses of the drive's frame that most of a window's sightings agree on, the best few that differ."""
    map_from_drive = _compose(window.poses, _inverse(drive_poses[window.node]))
    votes = np.array([_votes(drive_poses, window, pose) for pose in map_from_drive])
    kept: list[Floats] = []
    counts: list[float] = []
    for index in np.argsort(-votes, kind="stable"):
        if len(kept) == _CHOICES:
            break
        pose = _fitted(drive_poses, window, map_from_drive[index])
        here = _compose(pose[None], drive_poses[window.node[:1]])
        others = _compose(np.array(kept).reshape(-1, 3), drive_poses[window.node[:1]])
        if not _close(here, others, _SAME, _SAME_TURN).any():
            kept.append(pose)
            counts.append(_votes(drive_poses, window, pose))
    return _Votes(np.array(kept).reshape(-1, 3), np.array(counts), np.full(len(kept), number))


def _agreeing(drive_poses: Floats, window: Sightings, map_from_drive: Floats) -> NDArray[np.bool_]:
    """Which sightings are near where this pose of the drive's frame puts their nodes."""
    return _close(_compose(map_from_drive[None], drive_poses[window.node]), window.poses, _NEAR, _NEAR_TURN)


def _votes(drive_poses: Floats, window: Sightings, map_from_drive: Floats) -> float:
    """Each node gives its best agreeing sighting's correlation, above the credible."""
    agreeing = _agreeing(drive_poses, window, map_from_drive)
    best = np.zeros(len(drive_poses))
    np.maximum.at(best, window.node[agreeing], window.score[agreeing] - _CREDIBLE)
    return float(best.sum())


def _fitted(drive_poses: Floats, window: Sightings, map_from_drive: Floats) -> Floats:
    """The pose of the drive's frame that fits the agreeing sightings best on average."""
    agreeing = window.chosen(_agreeing(drive_poses, window, map_from_drive))
    weights = agreeing.score - _CREDIBLE
    weights = weights / weights.sum()
    nodes = drive_poses[agreeing.node]
    excess = agreeing.poses[:, 2] - nodes[:, 2] - map_from_drive[2]
    yaw = map_from_drive[2] + weights @ _wrapped(excess)
    turned = _compose(np.array([[0.0, 0.0, yaw]]), nodes)
    return np.array([*(weights @ (agreeing.poses - turned)[:, :2]), yaw])


def _joined(parts: list[_Votes]) -> _Votes:
    return _Votes(
        np.concatenate([part.map_from_drive for part in parts]),
        np.concatenate([part.votes for part in parts]),
        np.concatenate([part.window for part in parts]),
    )


def _elected(opinions: _Votes, centres: Floats) -> dict[int, Floats]:
    """By window, the opinions that agree with the one most votes of all windows agree with. `centres` (V, 3) are where
    in the drive's frame each window is."""
    if not len(opinions.votes):
        return {}
    own = _compose(opinions.map_from_drive, centres)
    agree = np.stack(
        [_close(own, _compose(pose[None], centres), _SAME, _SAME_TURN) for pose in opinions.map_from_drive]
    )
    totals = _totals(agree, opinions)
    winner = int(totals.argmax())
    # What agrees with the winner speaks for no other, though it may be near enough to one.
    runner_up = float(_totals(agree & ~agree[winner], opinions)[~agree[winner]].max(initial=0.0))
    if runner_up > _RUNNER_UP * totals[winner]:
        raise TrainingError(
            f"the drive fits two places of the map nearly alike ({totals[winner]:.0f} and {runner_up:.0f} votes): the "
            "ceiling repeats itself; drive longer, nearer to walls, in the light the map was taught in, or start a new "
            "map with --fresh"
        )
    with_winner = np.flatnonzero(agree[winner])
    ranked = with_winner[np.argsort(opinions.votes[with_winner], kind="stable")]
    return {int(opinions.window[k]): opinions.map_from_drive[k] for k in ranked if opinions.votes[k] > 0.0}


def _totals(agree: NDArray[np.bool_], opinions: _Votes) -> Floats:
    """(V,) votes of all windows for each opinion: a window gives those of its best opinion that agrees (V, V)."""
    totals = np.zeros(len(agree))
    for window in np.unique(opinions.window):
        members = opinions.window == window
        totals += (agree[:, members] * opinions.votes[members]).max(1)
    return totals


def _compose(a: Floats, b: Floats) -> Floats:
    """(N, 3) poses b seen from the frames in which a are."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    x, y = c * b[:, 0] - s * b[:, 1], s * b[:, 0] + c * b[:, 1]
    return np.stack([a[:, 0] + x, a[:, 1] + y, a[:, 2] + b[:, 2]], 1)


def _inverse(poses: Floats) -> Floats:
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = poses[:, 0], poses[:, 1]
    return np.stack([-c * x - s * y, s * x - c * y, -poses[:, 2]], 1)


def _close(a: Floats, b: Floats, distance: float, turn: float) -> NDArray[np.bool_]:
    apart = a - b
    return np.asarray((np.hypot(apart[:, 0], apart[:, 1]) < distance) & (np.abs(_wrapped(apart[:, 2])) < turn))


def _wrapped(angle: Floats) -> Floats:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))
