"""The offset to the goal, filtered: one Kalman filter an axis (thesis §6.5.5, Eqs 6.10-6.17)."""

from __future__ import annotations

import math
from dataclasses import dataclass

PROCESS_VARIANCE = 0.02  # m^2 a metre driven: "2 % of |u|", on both axes [assumed]
# m^2, [assumed]. Measurements share links and so their errors: what is below half a node's spacing is not known.
FLOOR = 0.05**2
ARRIVED = 0.15  # m


@dataclass(slots=True)
class _Axis:
    """Offset left on one axis (m), and its variance s (m^2)."""

    offset: float
    variance: float

    def predict(self, moved: float, process: float) -> None:
        self.offset -= moved
        self.variance += process

    def update(self, measured: float, noise: float) -> None:
        if self.variance + noise <= 0.0:  # the robot's node is the target
            return
        gain = self.variance / (self.variance + noise)
        self.offset += gain * (measured - self.offset)
        self.variance = max(self.variance - gain * self.variance, FLOOR)


class OffsetFilter:
    """Where the goal lies from the robot, in compass axes; starts from its first measurement [assumed]."""

    def __init__(self, z: tuple[float, float], r: float) -> None:
        self._x, self._y = _Axis(z[0], max(r, FLOOR)), _Axis(z[1], max(r, FLOOR))

    @property
    def offset(self) -> tuple[float, float]:
        return self._x.offset, self._y.offset

    @property
    def variance(self) -> float:
        """m^2; both axes are told the same noise, so they have the same variance."""
        return self._x.variance

    @property
    def distance(self) -> float:
        return math.hypot(self._x.offset, self._y.offset)

    def predict(self, dx: float, dy: float) -> None:
        """The robot moved by (dx, dy) m in compass axes (6.10-6.13)."""
        process = PROCESS_VARIANCE * math.hypot(dx, dy)
        self._x.predict(dx, process)
        self._y.predict(dy, process)

    def update(self, z: tuple[float, float], r: float) -> None:
        """The map says that the goal is z away, with variance r an axis (6.14-6.17)."""
        self._x.update(z[0], r)
        self._y.update(z[1], r)

    def arrived(self) -> bool:
        """Both axes within one standard deviation of 0, or nearer than 0.15 m."""
        within = all(abs(axis.offset) < math.sqrt(axis.variance) for axis in (self._x, self._y))
        return within or self.distance < ARRIVED
