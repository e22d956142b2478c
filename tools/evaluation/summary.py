"""One run, and what many runs come to: the layout of the JSON that `tools/evaluate` writes, and its table."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, wrap

WITHIN = (0.10, 0.15, 0.25, 0.50, 1.00)  # metres; 0.50 is the figure of the thesis
ARRIVED, DOCKED = "ARRIVED", "DOCKED"
ELSEWHERE = 0.5  # m; whoever says it arrived farther off than this is at a wrong place
THERE = 0.15  # m within which a carried robot has found its goal all the same


@dataclass(frozen=True, slots=True)
class Carried:
    """A robot carried while it was on its way: to where, how long after setting out, and how long (s) until it knew
    where it was and did not forget it again; None: it never did."""

    to: Pose2D
    after: float
    recovered: float | None


@dataclass(frozen=True, slots=True)
class Run:
    """One job from start to end; all poses are the simulator's truth. A failed job counts where it ended.

    `condition` is what the robot was tried under; `message` is the robot's own account of a failure, `report` of any
    end.
    """

    start: Pose2D
    goal: Pose2D
    final: Pose2D
    seconds: float
    result: str
    condition: str = "nominal"
    carried: Carried | None = None
    message: str = ""
    report: Mapping[str, object] = field(default_factory=dict)

    @property
    def error_m(self) -> float:
        return self.goal.distance(self.final)

    @property
    def error_rad(self) -> float:
        """Heading error, never negative."""
        return abs(wrap(self.final.yaw - self.goal.yaw))

    @property
    def succeeded(self) -> bool:
        """By its own account."""
        return self.result in (ARRIVED, DOCKED)

    @property
    def false_arrival(self) -> bool:
        return self.succeeded and self.error_m > ELSEWHERE

    def as_json(self) -> dict[str, object]:
        values: dict[str, object] = {
            "start": _triple(self.start),
            "goal": _triple(self.goal),
            "final": _triple(self.final),
            "error_m": self.error_m,
            "error_rad": self.error_rad,
            "seconds": self.seconds,
            "result": self.result,
            "condition": self.condition,
        }
        if self.carried is not None:
            values |= {
                "carried_to": _triple(self.carried.to),
                "carried_after_s": self.carried.after,
                "recovered_s": self.carried.recovered,
            }
        if self.message:
            values |= {"message": self.message}
        if self.message or self.report:
            values |= {"report": dict(self.report)}
        return values


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics over all runs, failed ones included; `sd_m` is the sample's (n - 1); shares of 1."""

    n: int
    mean_m: float
    sd_m: float
    median_m: float
    max_m: float
    within: dict[str, float]
    median_deg: float
    results: dict[str, int]
    median_s: float
    lost: int
    false_arrivals: int

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Summary:
        """Raises ValueError where there is no run."""
        if not runs:
            raise ValueError("no runs to summarise")
        errors = [run.error_m for run in runs]
        return cls(
            n=len(runs),
            mean_m=statistics.fmean(errors),
            sd_m=statistics.stdev(errors) if len(errors) > 1 else 0.0,
            median_m=statistics.median(errors),
            max_m=max(errors),
            within={f"{limit:.2f}": sum(e <= limit for e in errors) / len(errors) for limit in WITHIN},
            median_deg=math.degrees(statistics.median(run.error_rad for run in runs)),
            results=dict(Counter(run.result for run in runs).most_common()),
            median_s=statistics.median(run.seconds for run in runs),
            lost=sum(run.result == ErrorName.LOST.value for run in runs),
            false_arrivals=sum(run.false_arrival for run in runs),
        )

    def table(self) -> str:
        """For a person: centimetres, per cent, and how the jobs ended."""
        lengths = {"mean": self.mean_m, "deviation": self.sd_m, "median": self.median_m, "worst": self.max_m}
        rows = {"runs": f"{self.n}"}
        rows |= {f"error, {name}": f"{100 * value:.3g} cm" for name, value in lengths.items()}
        rows |= {f"within {limit} m": f"{100 * share:.1f} %" for limit, share in self.within.items()}
        rows |= {"heading error, median": f"{self.median_deg:.2f} deg", "time, median": f"{self.median_s:.1f} s"}
        rows |= {f"ended {name}": f"{count}" for name, count in self.results.items()}
        rows |= {"arrived at a wrong place": f"{self.false_arrivals}"}
        return as_table(rows)


def as_table(rows: Mapping[str, str]) -> str:
    return "\n".join(f"{name:<32}{value:>12}" for name, value in rows.items())


def by_condition(runs: Sequence[Run]) -> dict[str, dict[str, object]]:
    """A summary for each condition, in the order tried."""
    names = dict.fromkeys(run.condition for run in runs)
    return {name: asdict(Summary.of([run for run in runs if run.condition == name])) for name in names}


def recovery(runs: Sequence[Run]) -> dict[str, float | int | None]:
    """How the carried robots did: how many found themselves again and how fast, and the share that arrived."""
    carried = [run for run in runs if run.carried is not None]
    times = sorted(run.carried.recovered for run in carried if run.carried and run.carried.recovered is not None)
    there = sum(run.succeeded and run.error_m <= THERE for run in carried)
    return {
        "n": len(carried),
        "recovered": len(times),
        "median_s": statistics.median(times) if times else None,
        "p90_s": times[math.ceil(0.9 * len(times)) - 1] if times else None,
        "max_s": times[-1] if times else None,
        "arrived_share": there / len(carried) if carried else None,
    }


def _triple(pose: Pose2D) -> list[float]:
    return [pose.x, pose.y, pose.yaw]
