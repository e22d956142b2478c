"""One run, and what many runs come to: the layout of the JSON that `tools/evaluate` writes, and its table."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from omnibotd.core.geometry import Pose2D, wrap

WITHIN = (0.10, 0.15, 0.25, 0.50, 1.00)  # metres; 0.50 is the figure of the thesis


@dataclass(frozen=True, slots=True)
class Run:
    """One job from start to end; all poses are the simulator's truth. A failed job counts where it ended."""

    start: Pose2D
    goal: Pose2D
    final: Pose2D
    seconds: float
    result: str

    @property
    def error_m(self) -> float:
        return self.goal.distance(self.final)

    @property
    def error_rad(self) -> float:
        """Heading error, never negative."""
        return abs(wrap(self.final.yaw - self.goal.yaw))

    def as_json(self) -> dict[str, object]:
        return {
            "start": _triple(self.start),
            "goal": _triple(self.goal),
            "final": _triple(self.final),
            "error_m": self.error_m,
            "error_rad": self.error_rad,
            "seconds": self.seconds,
            "result": self.result,
        }


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
        )

    def table(self) -> str:
        """For a person: centimetres, per cent, and how the jobs ended."""
        lengths = {"mean": self.mean_m, "deviation": self.sd_m, "median": self.median_m, "worst": self.max_m}
        rows = {"runs": f"{self.n}"}
        rows |= {f"error, {name}": f"{100 * value:.1f} cm" for name, value in lengths.items()}
        rows |= {f"within {limit} m": f"{100 * share:.1f} %" for limit, share in self.within.items()}
        rows |= {"heading error, median": f"{self.median_deg:.2f} deg"}
        rows |= {f"ended {name}": f"{count}" for name, count in self.results.items()}
        return "\n".join(f"{name:<32}{value:>12}" for name, value in rows.items())


def _triple(pose: Pose2D) -> list[float]:
    return [pose.x, pose.y, pose.yaw]
