"""How well does this installation dock? Out of the dock, a little aside, in again, so many times."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, pstdev

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.approach import Limits
from omnibotd.core.docking.undocking import Undocking
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import Job

# Trips miss the staging pose by a few centimetres and degrees; this is a little more (m, rad).
_ASIDE, _ASIDE_YAW = 0.08, math.radians(20.0)
# Failures after which the next trial may well succeed.
_COUNTED = {
    ErrorName.FAILED_TO_DETECT_DOCK,
    ErrorName.FAILED_TO_CONTROL,
    ErrorName.FAILED_TO_CHARGE,
    ErrorName.FAILED_TO_STAGE,
    ErrorName.TIMEOUT,
}


@dataclass(frozen=True, slots=True)
class Trial:
    """One docking from `start` (staging_from_base): `offset` is the dock_from_base registered at its end, None where
    none was; `error` None where it docked."""

    start: Pose2D
    seconds: float
    retries: int
    offset: Pose2D | None
    error: ErrorName | None
    message: str


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation (of the population) of a quantity over the trials that docked."""

    mean: float
    sd: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """None of no values."""
        return cls(fmean(values), pstdev(values)) if values else None


def summary(trials: Sequence[Trial]) -> dict[str, Spread | None]:
    """What the trials that docked have in common: `x`, `y` (m), `yaw` (rad), `distance` (m), `seconds`, `retries`."""
    docked = [trial for trial in trials if trial.error is None]
    poses = [trial.offset for trial in docked if trial.offset is not None]
    return {
        "x": Spread.of([pose.x for pose in poses]),
        "y": Spread.of([pose.y for pose in poses]),
        "yaw": Spread.of([pose.yaw for pose in poses]),
        "distance": Spread.of([math.hypot(pose.x, pose.y) for pose in poses]),
        "seconds": Spread.of([trial.seconds for trial in docked]),
        "retries": Spread.of([float(trial.retries) for trial in docked]),
    }


def offsets(count: int, seed: int) -> list[Pose2D]:
    """Where the trials start, relative to the staging pose."""
    rng = random.Random(seed)
    ranges = (_ASIDE, _ASIDE, _ASIDE_YAW)
    return [Pose2D(*(rng.uniform(-limit, limit) for limit in ranges)) for _ in range(count)]


class Trials:
    """Docks, then for each of the starts leaves the dock and docks again. A docking that fails is counted, and the
    robot brought back by a whole trip; the job fails where that fails, too, or where the robot must not go on."""

    def __init__(
        self, starts: Sequence[Pose2D], limits: Limits, trip: Callable[[], Job], dock: Callable[[], Job]
    ) -> None:
        """`trip` makes a job that docks from anywhere, `dock` one that docks from about the staging pose.

        Both are called in the control tick: they must be quick.
        """
        self._starts, self._limits = tuple(starts), limits
        self._make_trip, self._make_dock = trip, dock
        self._ending: Outcome | None = None
        self._began = self._now = 0.0
        self._last: Decision | None = None
        self.trials: list[Trial] = []
        self._course = self._run()
        self._job = next(self._course)

    def step(self, seen: Observation) -> Decision:
        """One tick; `loop` counts the trials, from 1."""
        self._now = seen.stamp
        decision = self._last = self._job.step(seen)
        number = min(len(self.trials) + 1, len(self._starts))
        if decision.outcome is not None:
            self._go_on(decision.outcome)
        return replace(decision, loop=number, outcome=self._ending)

    def _go_on(self, outcome: Outcome) -> None:
        try:
            self._job = self._course.send(outcome)
            self._began = self._now
        except StopIteration as end:
            self._ending = end.value

    def _run(self) -> Generator[Job, Outcome, Outcome]:
        """Yields one job after the other and is sent their outcomes; returns how it all ended."""
        docked = yield self._make_trip()
        for number, start in enumerate(self._starts, 1):
            if docked.error is not None:
                return self._stopped(number, "could not be docked", docked)
            out = yield Undocking(self._limits, start)
            if out.error is not None:
                return self._stopped(number, "did not leave the dock", out)
            docked = yield self._make_dock()
            self._note(start, docked)
            if docked.error is not None and docked.error not in _COUNTED:
                return self._stopped(number, "could not go on", docked)
            if docked.error is not None and number < len(self._starts):
                docked = yield self._make_trip()
        return Outcome(None, f"docked in {sum(t.error is None for t in self.trials)} of {len(self.trials)} trials")

    def _note(self, start: Pose2D, outcome: Outcome) -> None:
        pose = [outcome.report.get(key) for key in ("dock_x", "dock_y", "dock_yaw")]
        offset = Pose2D(*(float(value) for value in pose if value is not None)) if None not in pose else None
        retries = self._last.recoveries if self._last is not None else 0
        seconds = self._now - self._began
        self.trials.append(Trial(start, seconds, retries, offset, outcome.error, outcome.message))

    def _stopped(self, number: int, what: str, outcome: Outcome) -> Outcome:
        docked = sum(trial.error is None for trial in self.trials)
        message = f"trial {number} of {len(self._starts)}: the robot {what}: {outcome.message}"
        return Outcome(outcome.error, message, {**outcome.report, "trials": float(len(self.trials)), "docked": docked})
