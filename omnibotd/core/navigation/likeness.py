"""What likeness means under one ceiling, learnt from the map itself: how far two views that correlate so well can be
apart, and how alike places are that are not the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from omnibotd.core.navigation.node_index import NodeIndex
from omnibotd.core.vision.descriptor import Descriptor, harmonics

# Nodes probed, evenly along the drives: more moves the percentiles by a few hundredths, at a millisecond each.
_PROBES = 60
# Nodes at this distance (m) are the same place or another one; between the two neither is said.
_SAME, _OTHER = 0.6, 0.7
_COMPARED, _LOOKED_UP = 40, 20
# Only views this alike say how far likeness reaches; below, the parabola of correlation against distance has ended.
_ALIKE = 0.6
# Metres apart for a whole unit of correlation lost: under every ceiling tried between 0.6 and 1.6.
_LEAST_REACH, _MOST_REACH = 0.4, 2.0
_FEWEST = 30
_USUAL_REACH, _USUAL_CHANCE = 1.1, 0.45


@dataclass(frozen=True, slots=True)
class Likeness:
    """`reach` (m): 95 of 100 views that correlate at 1 - c are within reach * c. `chance`: what 95 of 100 best matches
    at another place stay below."""

    reach: float = _USUAL_REACH
    chance: float = _USUAL_CHANCE

    def distance(self, score: float) -> float:
        """Metres that a view may be from a node it correlates with at `score`."""
        return self.reach * (1.0 - score)


def measure(index: NodeIndex) -> Likeness:
    """From a sample of the nodes, each compared with its neighbours and with its look-alikes."""
    ratios, impostors = [], []
    for node in np.unique(np.linspace(0, len(index.poses) - 1, _PROBES).astype(int)):
        view = index.aligned(np.array([node]))
        query, (x, y) = harmonics(view)[0], index.poses[node, :2]
        near = index.near(float(x), float(y), _SAME, _COMPARED)
        near = near[near != node]
        _, score = index.compare(query, near)
        apart = np.hypot(*(index.poses[near, :2] - (x, y)).T)
        alike = score > _ALIKE
        ratios.append(apart[alike] / (1.0 - score[alike]))
        looks = index.alike(Descriptor.spectrum(view)[0], _LOOKED_UP)
        looks = looks[np.hypot(*(index.poses[looks, :2] - (x, y)).T) > _OTHER]
        if len(looks):
            impostors.append(float(index.compare(query, looks)[1].max()))
    every = np.concatenate(ratios)
    reach = _USUAL_REACH if len(every) < _FEWEST else float(np.percentile(every, 95))
    chance = max(_USUAL_CHANCE, float(np.percentile(impostors, 95))) if impostors else _USUAL_CHANCE
    return Likeness(min(max(reach, _LEAST_REACH), _MOST_REACH), chance)
