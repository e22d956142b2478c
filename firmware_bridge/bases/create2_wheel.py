"""One wheel of a Create 2: speeds in the steps its base knows, and counts given the direction its encoder lacks."""

from __future__ import annotations

MAX_SPEED = 500.0  # mm/s
# The base's speeds go in steps. What one set-point can't have the next make up for, so that even a creep of 3 mm/s
# moves the robot: without that a docking would stand still in front of the dock.
STEP = 28.5  # mm/s
MILLIMETRES_PER_TICK = 0.44456
# A wheel at the lowest step counts every 16 ms, telemetry comes every 15 ms.
REST = 0.08  # seconds without a count after which a wheel stands
MAX_TICKS_PER_SECOND = 1.5 * MAX_SPEED / MILLIMETRES_PER_TICK
SLACK = 0.1  # seconds by which a host's stall may bring two frames closer together than they were sent


class Wheel:
    """Asked for speeds, told the encoder's bare counts."""

    def __init__(self) -> None:
        self.ticks = 0
        self._carry = 0.0  # mm/s not yet driven
        self._direction = 0  # in which it turns, or was asked to turn last; 0: at rest, whoever pushes it now
        self._counted_at = float("-inf")
        self._raw: int | None = None
        self._requested = 0
        self._told_at = 0.0

    def ask(self, speed: float, now: float) -> int:
        """The speed to send (mm/s) for a wanted one; 0 until a wheel that turns the other way has come to rest.

        Counts have the sign of the command, so those of a wheel reversed while it rolls would be wrong.
        """
        direction = (speed > 0.0) - (speed < 0.0)
        rolling = self._direction != 0 and now - self._counted_at < REST
        if direction == 0 or (rolling and direction != self._direction):
            self._carry = 0.0
            return 0
        wanted = speed + self._carry
        sent = max(-MAX_SPEED, min(MAX_SPEED, round(wanted / STEP) * STEP))
        self._carry = max(-STEP, min(STEP, wanted - sent))
        if sent:
            self._direction = direction
            self._counted_at = max(self._counted_at, now)  # it is about to turn
        return round(sent)

    def plausible(self, raw: int, now: float) -> bool:
        """Whether the wheel can have come here since the last count taken."""
        return self._raw is None or abs(_signed16(raw - self._raw)) <= MAX_TICKS_PER_SECOND * (
            now - self._told_at + SLACK
        )

    def count(self, raw: int, requested: int, now: float) -> int:
        """Take the encoder's 16 bits and the speed (mm/s) that the base obeys; returns the ticks since the first.

        While the base obeys a speed, its counts have their sign, and a wrong one that slipped through the stream's
        weak sum is taken back by the next. Only of a wheel that rolls on without one the sign means nothing.
        """
        step = 0 if self._raw is None else _signed16(raw - self._raw)
        obeying = min(requested * self._direction, self._requested * self._direction) > 0
        self._raw, self._requested, self._told_at = raw, requested, now
        if step:
            self._counted_at = now
            self.ticks += step if obeying or not self._direction else abs(step) * self._direction
        elif now - self._counted_at >= REST:
            self._direction = 0
        return self.ticks


def _signed16(value: int) -> int:
    return (value + 2**15) % 2**16 - 2**15
