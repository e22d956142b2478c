"""What a visual compass says of two pictures (thesis, section 4.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from omnibotd.core.compass.round_view import RoundView

# The fields of expansion and contraction: this wide, ahead and behind, where driving moves the picture least (§4.2).
SECTOR = math.radians(60.0)
FRONT, BACK = 0.0, math.pi


@dataclass(frozen=True, slots=True)
class Turn:
    """By how much the robot turned, rad, counter-clockwise; `support` is how much says so, by the method's own count.

    Where nothing can be said the angle is 0, as the thesis has it, and `ok` is False.
    """

    angle: float
    support: int
    ok: bool = True


NO_TURN = Turn(0.0, 0, ok=False)


class Compass(Protocol):
    """One way to tell a turn from two pictures."""

    def turn(self, before: RoundView, now: RoundView) -> Turn:
        """From the one picture to the next; both with the same ring."""
        ...
