"""Links of the thesis' map: what makes two nodes look alike, and how sure each link's offset is (§6.5.4, §6.5.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import MapError
from omnibotd.core.mapping.topo_map import EdgeKind, TopoMap
from omnibotd.core.thesis.responses import unpack

Floats = NDArray[np.float64]

# Variance (m^2) of each metre driven: the printed "2 % of the distance", read as additive along a path [assumed].
ODOMETRY_VARIANCE = 0.02
# Variance (m^2) of the zero offset between nodes that only just look alike: the printed "at most 5 cm" [assumed].
SIMILARITY_VARIANCE = 0.05
# Where a map's statistics keep the difference of responses below which two sub-nodes were linked.
THRESHOLD = "similarity_threshold"


def similarity_threshold(responses: NDArray[np.float32]) -> float:
    """The median difference between consecutive nodes' responses [assumed]: as alike as a second's drive apart."""
    return float(np.median(np.linalg.norm(np.diff(responses, axis=0), axis=1)))


def similar_pairs(responses: NDArray[np.float32], units: NDArray[np.integer], threshold: float) -> NDArray[np.int32]:
    """Pairs (M, 2), lower first, of nodes of one unit whose responses differ less; not those driven in succession."""
    pairs = [np.zeros((0, 2), np.int32)]
    for unit in np.unique(units):
        siblings = np.flatnonzero(units == unit).astype(np.int32)
        first, second = np.nonzero(np.triu(_differences(responses[siblings]) < threshold, 1))
        found = np.column_stack([siblings[first], siblings[second]])
        pairs.append(found[found[:, 1] - found[:, 0] > 1])
    return np.concatenate(pairs)


def _differences(responses: NDArray[np.float32]) -> Floats:
    """(n, n) distances between response vectors; a row at a time, for a bucket may hold a whole map."""
    rows = [np.linalg.norm(responses - row, axis=1) for row in responses]
    return np.array(rows, np.float64)


def similarity_variance(difference: NDArray[np.floating] | float, threshold: float) -> Floats:
    """m^2 an axis, in proportion to the difference of responses, at most SIMILARITY_VARIANCE."""
    share = np.asarray(difference, np.float64) / max(threshold, 1e-9)
    return SIMILARITY_VARIANCE * np.minimum(share, 1.0)


@dataclass(frozen=True)
class Links:
    """Offsets (M, 2) from `first` to `second` in compass axes, m, and variances (M,) an axis, m^2."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    offsets: Floats
    variances: Floats

    @classmethod
    def of(cls, topo_map: TopoMap) -> Links:
        """Odometry links go as far as their nodes' positions differ, similarity links nowhere. MapError."""
        edges, responses = topo_map.edges, unpack(topo_map)
        if THRESHOLD not in topo_map.statistics:
            raise MapError(f"map {topo_map.name!r} lacks the statistic {THRESHOLD!r}: train it again")
        positions = topo_map.poses[:, :2].astype(np.float64)
        driven = (edges.kind == EdgeKind.ODOMETRY)[:, None]
        offsets = np.where(driven, positions[edges.second] - positions[edges.first], 0.0)
        difference = np.linalg.norm(responses[edges.first] - responses[edges.second], axis=1)
        alike = similarity_variance(difference, topo_map.statistics[THRESHOLD])
        variances = np.where(driven[:, 0], ODOMETRY_VARIANCE * np.hypot(*offsets.T), alike)
        return cls(edges.first, edges.second, offsets, variances)
