"""Landmarks that help from their first bearing: a ray and a guess of its inverse depth (Civera et al. 2008)."""

from __future__ import annotations

import math
from collections.abc import Hashable, Set

import numpy as np

from omnibotd.core.slam.bearing import ray_point
from omnibotd.core.slam.belief import Belief
from omnibotd.core.slam.sighting import Bearing

# Inverse depth (1/m) of a landmark not yet known, and its standard deviation: 1.1 m to infinity within one and a bit.
INVERSE_DEPTH, SPREAD = 0.45, 0.43
# Once the depth is known to a tenth, a point is as linear as the ray and half as large.
CERTAIN = 0.1
# Corrections must not put a landmark behind the robot: 50 m is as good as infinity indoors.
LEAST_INVERSE_DEPTH = 0.02


class InverseDepth:
    """Maps every landmark at first sight."""

    def sight(self, belief: Belief, bearing: Bearing, variance: float, stamp: float) -> bool:
        del stamp
        x, y, heading = belief.pose
        ray = np.array([x, y, heading + bearing.angle, INVERSE_DEPTH])
        jacobian = np.eye(4, len(belief.mean))
        jacobian[3] = 0.0  # the depth depends on nothing known
        belief.append(bearing.name, ray, jacobian, np.diag([0.0, 0.0, variance, SPREAD**2]))
        return True

    def end_of_view(self, belief: Belief, seen: Set[Hashable], stamp: float) -> None:
        """Nothing waits."""


def settle(belief: Belief, name: Hashable) -> None:
    """Keeps a ray in front of where it was seen from, and makes it a point once its depth is certain."""
    span = belief.span(name)
    if span.stop - span.start != 4:
        return
    depth = span.stop - 1
    belief.mean[depth] = max(belief.mean[depth], LEAST_INVERSE_DEPTH)
    if math.sqrt(belief.covariance[depth, depth]) < CERTAIN * belief.mean[depth]:
        belief.replace(name, *ray_point(belief.mean[span]))
