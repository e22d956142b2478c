"""Bearings of landmarks that are not in the map yet, and what puts landmarks there."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Set
from dataclasses import dataclass
from typing import Protocol

from omnibotd.core.slam.belief import Belief


@dataclass(frozen=True, slots=True)
class Bearing:
    """Direction `angle` (rad, counter-clockwise from ahead) in which the landmark `name` was seen."""

    name: Hashable
    angle: float


@dataclass(frozen=True, slots=True)
class Frozen:
    """Names the pose at `stamp` (s) in a belief; all landmarks first seen from there share it."""

    stamp: float


@dataclass(frozen=True, slots=True)
class Waiting:
    """A bearing (rad) that waits for others, and the pose it was taken from."""

    angle: float
    pose: Frozen


class Initialiser(Protocol):
    """How landmarks enter the map: as a part of the belief with their name, of 2 numbers (a point) or 4 (a ray)."""

    def sight(self, belief: Belief, bearing: Bearing, variance: float, stamp: float) -> bool:
        """Takes a bearing (rad^2) of an unmapped landmark at `stamp` (s); says whether it is mapped now.

        A bearing taken here must not correct the pose as well.
        """
        ...

    def end_of_view(self, belief: Belief, seen: Set[Hashable], stamp: float) -> None:
        """All bearings of this view were sighted: whatever waits for landmarks not `seen` may be given up."""
        ...


def freeze(belief: Belief, stamp: float) -> Frozen:
    """The name of the pose of now, kept in the belief."""
    name = Frozen(stamp)
    if name not in belief:
        belief.freeze(name)
    return name


def release(belief: Belief, waiting: Iterable[Waiting]) -> None:
    """Forgets the frozen poses that none of the waiting bearings was taken from."""
    needed = {bearing.pose for bearing in waiting}
    for name in belief.names:
        if isinstance(name, Frozen) and name not in needed:
            belief.remove(name)
