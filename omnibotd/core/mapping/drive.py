"""Reading a teaching drive: frames stream through, only views stay."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sized
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.descriptor import Descriptor
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.view import RINGS, SECTORS, View

# A node every 8 cm or 15 degrees: at 20 cm the local model of views is no longer linear, closer only costs memory.
NODE_SPACING, NODE_TURN = 0.08, math.radians(15.0)
# Frames nearer than this to the last one looked at add nothing, even to the SOM.
_LOOK_SPACING, _LOOK_TURN = 0.02, math.radians(3.0)
# Pairs of frames for measuring the ceiling's height: near enough to overlap, far enough to see parallax.
_BASELINE, _LONGEST_BASELINE = 0.25, 0.6
_LARGEST_PAIR_TURN = 0.5
# The median of thirty is steady; a reservoir of thirty pairs of JPEGs is 4 MB.
_PAIRS = 30


@dataclass(frozen=True, slots=True)
class TeachingSample:
    """A frame and where odometry had the base when it was taken; `stamp` in seconds."""

    stamp: float
    odom_from_base: Pose2D
    frame: Frame


@dataclass(frozen=True, slots=True)
class FramePair:
    """Two frames of the drive and the odometry between them."""

    first: Frame
    second: Frame
    second_from_first: Pose2D


@dataclass(frozen=True)
class Drive:
    """What is kept: spectra (n, F) of all views; odometry poses and views (N, RINGS, SECTORS) of the nodes."""

    samples: int
    spectra: NDArray[np.float32]
    odom_from_node: list[Pose2D]
    views: View
    contrast: float
    pairs: list[FramePair]

    def steps(self) -> NDArray[np.float64]:
        """(N, 3) pose of each node in the one before, by odometry; zero for the first."""
        poses = self.odom_from_node
        moves = [before.inverse() @ after for before, after in pairwise(poses)]
        return np.array([(0.0, 0.0, 0.0), *((m.x, m.y, m.yaw) for m in moves)])


def read_drive(
    samples: Iterable[TeachingSample], camera: CameraModel, seed: int, progress: Callable[[float], None]
) -> Drive:
    """Look at every sample once. An empty drive gives a Drive without nodes."""
    descriptor, pairs = Descriptor(camera), _PairReservoir(seed)
    spectra: list[NDArray[np.float32]] = []
    nodes: list[Pose2D] = []
    views: list[View] = []
    contrasts: list[float] = []
    last_look: Pose2D | None = None
    count, total = 0, len(samples) if isinstance(samples, Sized) else 0
    ending: tuple[Pose2D, NDArray[np.float32]] | None = None
    for sample in samples:
        count += 1
        if total and count % 50 == 0:
            progress(count / total)
        if last_look is not None and not _moved(last_look, sample.odom_from_base, _LOOK_SPACING, _LOOK_TURN):
            continue
        last_look = sample.odom_from_base
        view, contrast = descriptor.view_and_contrast(sample.frame)
        spectra.append(descriptor.spectrum(view))
        contrasts.append(contrast)
        pairs.offer(sample)
        if not nodes or _moved(nodes[-1], sample.odom_from_base, NODE_SPACING, NODE_TURN):
            nodes.append(sample.odom_from_base)
            views.append(view)
            ending = None
        else:
            ending = sample.odom_from_base, view
    if ending is not None:  # a drive often ends where it matters: in the dock
        nodes.append(ending[0])
        views.append(ending[1])
    return Drive(
        count,
        np.array(spectra, np.float32),
        nodes,
        np.array(views, np.float32).reshape(-1, RINGS, SECTORS),
        float(np.median(contrasts)) if contrasts else 0.0,
        pairs.kept,
    )


def _moved(since: Pose2D, now: Pose2D, distance: float, turn: float) -> bool:
    return since.distance(now) >= distance or abs(wrap(now.yaw - since.yaw)) >= turn


class _PairReservoir:
    """A fair sample of frame pairs a short baseline apart, from a drive of unknown length (reservoir sampling)."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._seen = 0
        self._first: TeachingSample | None = None
        self.kept: list[FramePair] = []

    def offer(self, sample: TeachingSample) -> None:
        if self._first is None:
            self._first = sample
            return
        second_from_first = sample.odom_from_base.inverse() @ self._first.odom_from_base
        distance = math.hypot(second_from_first.x, second_from_first.y)
        if distance > _LONGEST_BASELINE or abs(second_from_first.yaw) > _LARGEST_PAIR_TURN:
            self._first = sample
        elif distance >= _BASELINE:
            self._keep(FramePair(self._first.frame, sample.frame, second_from_first))
            self._first = sample

    def _keep(self, pair: FramePair) -> None:
        self._seen += 1
        if len(self.kept) < _PAIRS:
            self.kept.append(pair)
            return
        slot = int(self._rng.integers(self._seen))
        if slot < _PAIRS:
            self.kept[slot] = pair
