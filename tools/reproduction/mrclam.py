"""The UTIAS MRCLAM recordings: one robot's odometry, bearings of landmarks and true poses, as events in time.

Leung, Halpern, Barfoot, Liu 2011, "The UTIAS multi-robot cooperative localization and mapping dataset", IJRR 30(8).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.slam.motion import WheelStep
from omnibotd.core.slam.sighting import Bearing

Floats = NDArray[np.float64]
DATA = Path(__file__).resolve().parents[3] / "shared/data/mrclam7"
FIRST_LANDMARK = 6  # subjects 1 to 5 are robots
SILENCE = 0.1  # s without odometry that count as a gap


@dataclass(frozen=True, slots=True)
class Wheels:
    """From logged to true speeds, for the log behaves like commands: factor, loss by turning (m), factor, lag (s)."""

    forward: float = 1.0
    loss: float = 0.0
    turn: float = 1.0
    lag: float = 0.0


RAW = Wheels()
# Fitted to truth on robots 1 to 3 of set 7, and used for all.
CALIBRATED = Wheels(1.045, 0.092, 0.95, 0.22)


@dataclass(frozen=True, slots=True)
class Recording:
    """Events at `stamps` (n,) s: `views` then, `steps` to the next (n - 1), true poses (n, 3), which are `scored`."""

    stamps: Floats
    views: list[list[Bearing]]
    steps: list[WheelStep]
    truth: Floats
    scored: NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Harm:
    """What is done to a recording: only every `thin`th bearing is kept, `noise` (rad, standard deviation) is added, a
    share is `misnamed` as another landmark, so many landmarks are `absent`: never seen."""

    thin: int = 1
    noise: float = 0.0
    misnamed: float = 0.0
    absent: int = 0
    seed: int = 1

    def done(self, made: Recording) -> Recording:
        """To the bearings of a recording; wheels and truth stay."""
        rng = np.random.default_rng(self.seed)
        names = sorted({one.name for view in made.views for one in view}, key=str)
        gone = set(rng.permutation(len(names))[: self.absent].tolist())
        left = [name for i, name in enumerate(names) if i not in gone]
        bearings = self._kept([one for view in made.views for one in view], set(left), left, rng)
        return replace(made, views=[[kept for _ in view if (kept := next(bearings))] for view in made.views])

    def _kept(
        self, bearings: list[Bearing], seen: set[Hashable], names: list[Hashable], rng: np.random.Generator
    ) -> Iterator[Bearing | None]:
        for number, one in enumerate(bearings):
            noise, fate, other = self.noise * rng.standard_normal(), rng.random(), int(rng.integers(len(names)))
            if number % self.thin or one.name not in seen:
                yield None
            else:
                yield Bearing(names[other] if fate < self.misnamed else one.name, one.angle + noise)


UNHARMED = Harm()


class RecordingError(Exception):
    """A folder that is no MRCLAM set."""


def load(folder: Path, robot: int, wheels: Wheels = CALIBRATED) -> Recording:
    """Of one robot; scored once a second."""
    odometry, measured, truth = (_table(folder, f"Robot{robot}_{kind}") for kind in _KINDS)
    subjects = {int(code): int(subject) for subject, code in _table(folder, "Barcodes")}
    begin, end = odometry[0, 0], min(odometry[-1, 0], truth[-1, 0])
    inside = measured[(measured[:, 0] >= begin) & (measured[:, 0] <= end)]
    seen = [(row[0], subjects.get(int(row[1]), 0), row[3]) for row in inside]
    seen = [one for one in seen if one[1] >= FIRST_LANDMARK]
    grid = np.arange(begin, end, 1.0)
    stamps = np.unique(np.concatenate([grid, [stamp for stamp, _, _ in seen]]))
    views: list[list[Bearing]] = [[] for _ in stamps]
    for stamp, subject, angle in seen:
        views[int(np.searchsorted(stamps, stamp))].append(Bearing(subject, float(angle)))
    track = _Track(odometry, wheels)
    return Recording(stamps, views, track.steps(stamps), _at(truth, stamps), np.searchsorted(stamps, grid))


_KINDS = ("Odometry", "Measurement", "Groundtruth")


def _table(folder: Path, name: str) -> Floats:
    path = folder / f"{name}.dat"
    try:
        return np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: {error}; give the folder of an MRCLAM set with --data") from error


def _at(truth: Floats, stamps: Floats) -> Floats:
    columns = (truth[:, 1], truth[:, 2], np.unwrap(truth[:, 3]))
    return np.stack([np.interp(stamps, truth[:, 0], column) for column in columns], axis=1)


class _Track:
    """Dead reckoning: each logged speed holds until the next; the robot rests before the first."""

    def __init__(self, odometry: Floats, wheels: Wheels) -> None:
        stamps = odometry[:, 0] + wheels.lag
        kept = np.concatenate([[True], np.diff(stamps) > 1e-6])
        speed = wheels.forward * odometry[:, 1] - wheels.loss * np.abs(odometry[:, 2]) * (odometry[:, 1] > 1e-6)
        self._stamps = np.concatenate([[stamps[0] - 1e4], stamps[kept]])
        self._speeds = np.concatenate([[0.0], np.maximum(speed[kept], 0.0)])
        self._turns = np.concatenate([[0.0], wheels.turn * odometry[kept, 2]])
        dt = np.diff(self._stamps)
        self._poses = self._reckoned(dt)
        silence = np.where(dt > SILENCE, dt, 0.0)
        silence[0] = 0.0
        paths = (np.abs(self._speeds[:-1]) * dt, np.abs(self._turns[:-1]) * dt, silence)
        self._paths = [np.concatenate([[0.0], np.cumsum(path)]) for path in paths]

    def steps(self, stamps: Floats) -> list[WheelStep]:
        """Between one stamp and the next."""
        poses = [Pose2D(*pose) for pose in self._at(stamps)]
        moves = [a.inverse() @ b for a, b in pairwise(poses)]
        paths = np.diff([np.interp(stamps, self._stamps, path) for path in self._paths], axis=1).T
        return [WheelStep(move, *map(float, path)) for move, path in zip(moves, paths, strict=True)]

    def _reckoned(self, dt: Floats) -> Floats:
        headings = np.concatenate([[0.0], np.cumsum(self._turns[:-1] * dt)])
        half = self._turns[:-1] * dt / 2.0
        chords = self._speeds[:-1] * dt * np.sinc(half / np.pi)
        middle = headings[:-1] + half
        moves = np.stack([chords * np.cos(middle), chords * np.sin(middle)], axis=1)
        return np.column_stack([np.vstack([np.zeros(2), np.cumsum(moves, axis=0)]), headings])

    def _at(self, stamps: Floats) -> Floats:
        last = np.searchsorted(self._stamps, stamps, "right") - 1
        dt = stamps - self._stamps[last]
        half = self._turns[last] * dt / 2.0
        chords, middle = self._speeds[last] * dt * np.sinc(half / np.pi), self._poses[last, 2] + half
        moves = np.stack([chords * np.cos(middle), chords * np.sin(middle), 2.0 * half], axis=1)
        return np.asarray(self._poses[last] + moves)


def aligned_error(found: Floats, truth: Floats) -> float:
    """RMSE (m) of positions (n, 2) after the turn and shift that fit them best."""
    a, b = found - found.mean(0), truth - truth.mean(0)
    turn = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    c, s = np.cos(turn), np.sin(turn)
    return float(np.sqrt(((a @ np.array([[c, s], [-s, c]]) - b) ** 2).sum(1).mean()))
