"""Which landmark is it? For bearings without a name: gated nearest neighbour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from omnibotd.core.slam.bearing import wrapped
from omnibotd.core.slam.bearing_slam import BearingSlam
from omnibotd.core.slam.sighting import Bearing

# Normalised innovation squared within which a bearing may be a landmark's, and beyond which of all it is a new one's.
# Between the two nobody knows, and a wrong name does more harm than a bearing unused.
SAME, NEW = 9.0, 25.0
# Likeliness (chi^2 and log of the variance) by which the best name must beat the next.
CLEAR = 4.0


class NearestNeighbour:
    """Names bearings after the landmarks of a filter, and new ones by numbers of its own.

    For filters that map at first sight (`InverseDepth`): what is not in the map yet can't be recognised.
    """

    def __init__(self) -> None:
        self._named = 0

    def named(self, slam: BearingSlam, angles: Sequence[float]) -> list[Bearing]:
        """Bearings of one view; each landmark is named once at most, unclear ones are left out."""
        names = list(slam.names)
        if not names:
            return [self._new(angle) for angle in angles]
        expected = slam.innovations([Bearing(name, 0.0) for name in names])
        off = wrapped(np.asarray(angles)[:, None] + expected.values)
        squares = off**2 / expected.variances
        badness = np.where(squares < SAME, squares + np.log(expected.variances), np.inf)
        found: list[Bearing] = []
        taken: set[int] = set()
        for i in np.argsort(badness.min(axis=1)):
            best = int(badness[i].argmin())
            others = np.delete(badness[i], best)
            if squares[i].min() > NEW:
                found.append(self._new(angles[i]))
            elif best not in taken and badness[i, best] + CLEAR < others.min(initial=np.inf):
                found.append(Bearing(names[best], float(angles[i])))
                taken.add(best)
        return found

    def _new(self, angle: float) -> Bearing:
        self._named += 1
        return Bearing(("found", self._named), float(angle))
