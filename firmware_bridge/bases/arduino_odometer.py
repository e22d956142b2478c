"""Which encoder counts of an arduino_bridge board to believe.

Its replies have no checksum, and it reads its counts while interrupts change them: a byte that carries over is 256
ticks. A reading counts only if the wheels could have turned that far. Counts are absolute, so a wrong reading that was
believed is put right by the next one: errors never add up.
"""

from __future__ import annotations

FASTER = 2.0  # times the speed that can be asked for: pushed, downhill, or the board's control overshoots
JUMPS = 3  # impossible readings in a row that agree with each other: the counts have a new origin


class Odometer:
    """Unwraps the counts of both wheels since its making, and tells the believable from the impossible."""

    def __init__(self, counts: tuple[int, int], asked_at: float, fastest: float) -> None:
        """`fastest` that may be asked for, ticks/s; `asked_at`: the earliest moment at which these were read."""
        self.total = (0, 0)
        self._fastest = FASTER * fastest
        self._counts, self._since = counts, asked_at
        self._strange: tuple[tuple[int, int], float] | None = None
        self._jumps = 0

    @property
    def disturbed(self) -> bool:
        """Whether the newest reading was not believed."""
        return self._strange is not None

    @property
    def displaced(self) -> bool:
        """Whether the counts go on elsewhere: the board began anew."""
        return self._jumps >= JUMPS

    def take(self, counts: tuple[int, int], asked_at: float, now: float) -> bool:
        """Whether the reading is believed, and is in `total`; `asked_at` as above."""
        if _reachable(self._counts, counts, self._fastest * (now - self._since)):
            moved = _differences(self._counts, counts)
            self.total = (self.total[0] + moved[0], self.total[1] + moved[1])
            self._counts, self._since = counts, asked_at
            self._strange, self._jumps = None, 0
            return True
        if self._strange is None or _reachable(self._strange[0], counts, self._fastest * (now - self._strange[1])):
            self._jumps += 1
        else:
            self._jumps = 1
        self._strange = (counts, asked_at)
        return False

    def doubt(self) -> None:
        """The board may have restarted: one impossible reading more proves it."""
        self._strange, self._jumps = None, max(self._jumps, JUMPS - 1)


def _differences(before: tuple[int, int], after: tuple[int, int]) -> tuple[int, int]:
    """Across the wrap of 32-bit counts."""
    left, right = ((b - a + 2**31) % 2**32 - 2**31 for a, b in zip(before, after, strict=True))
    return left, right


def _reachable(before: tuple[int, int], after: tuple[int, int], ticks: float) -> bool:
    """One tick more than `ticks` for the edge that each reading may stand on."""
    return max(map(abs, _differences(before, after))) <= ticks + 1.0
