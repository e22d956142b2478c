"""How the cost of a cycle grows with the map, beside the thesis' buckets and a search through all nodes."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.mapping.som import Som
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.node_index import NodeIndex
from omnibotd.core.thesis.responses import Buckets, Classifier
from omnibotd.core.vision.descriptor import FEATURES
from tools.benchmark import literal, rooms
from tools.benchmark.cycle import WARM_UP, Cycle, Footage
from tools.benchmark.measuring import Times, settle

CYCLE, BUCKETS, BRUTE_FORCE = "default cycle", "thesis' bucket search", "all nodes' spectra"


class BucketSearch:
    """The thesis' look-up: 100 full comparisons, then the classified vectors of one bucket (§6.3.2)."""

    def __init__(self, codebook: NDArray[np.float32], responses: NDArray[np.float32]) -> None:
        self._classify, self._responses = Classifier(codebook), responses
        self._buckets = Buckets(responses.argmin(1), math.isqrt(len(codebook)))

    def find(self, vector: NDArray[np.float32]) -> int:
        response = self._classify(vector)
        nodes = self._buckets.near(int(response.argmin()))
        return int(nodes[np.linalg.norm(self._responses[nodes] - response, axis=1).argmin()])


def measure(sizes: Sequence[int], per_room: int, frames: int, rounds: int, perceptions: int) -> dict[str, Any]:
    """Round after round, each search of each map has the whole drive to itself."""
    footage, times, memory = Footage.of(frames), Times(), {}
    cycles = {}
    searches: dict[str, Callable[[int], Any]] = {}
    for size in sizes:
        topo_map = rooms.large_map(size, per_room)
        memory[size] = {"index_bytes": _index_bytes(topo_map), "map_bytes": _array_bytes(topo_map)}
        cycle = cycles[size] = Cycle(topo_map)
        searches[f"{CYCLE}/{size}"] = lambda k, cycle=cycle: cycle.step(footage.frames[k], footage.odom_from_base[k])
        searches[f"{BUCKETS}/{size}"] = _bucket_search(size, perceptions)
        searches[f"{BRUTE_FORCE}/{size}"] = _brute_force(size)
    settle()
    for _ in range(rounds):
        for cycle in cycles.values():
            cycle.restart()
        for name, search in searches.items():
            for k in range(frames):
                (times if k >= WARM_UP else Times()).measure(name, partial(search, k))
    return _summary(times, sizes, memory)


def _bucket_search(size: int, perceptions: int) -> Callable[[int], Any]:
    vectors, poses = literal.perceptions(perceptions)
    som = Som.train(vectors)
    responses, _ = literal.repeated(som.distances(vectors), poses, size)
    search = BucketSearch(som.codebook, responses)
    return lambda k: search.find(vectors[k % len(vectors)])


def _brute_force(size: int) -> Callable[[int], Any]:
    """One product of a spectrum with those of all nodes."""
    rng = np.random.default_rng(rooms.SEED)
    spectra = rng.standard_normal((size, FEATURES), np.float32)
    squares = np.einsum("nf,nf->n", spectra, spectra)
    return lambda k: (squares - 2.0 * (spectra @ spectra[k % size])).argmin()


def _index_bytes(topo_map: TopoMap) -> int:
    """What the localiser's search structures hold beside the map."""
    tracemalloc.start()
    index = NodeIndex(topo_map)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    del index
    return held


def _array_bytes(topo_map: TopoMap) -> int:
    edges = topo_map.edges
    arrays = (topo_map.codebook, topo_map.units, topo_map.snapshots, topo_map.poses, topo_map.sessions)
    return sum(array.nbytes for array in (*arrays, edges.first, edges.second, edges.kind))


def _summary(times: Times, sizes: Sequence[int], memory: dict[int, dict[str, int]]) -> dict[str, Any]:
    table = times.table()
    rows = {
        str(size): {what: table[f"{what}/{size}"] for what in (CYCLE, BUCKETS, BRUTE_FORCE)} | memory[size]
        for size in sizes
    }
    # From the second size on: that is the thesis' 4000 nodes.
    from_size, to_size = sizes[min(1, len(sizes) - 1)], sizes[-1]
    growth = {
        what: times.median(f"{what}/{to_size}") / times.median(f"{what}/{from_size}")
        for what in (CYCLE, BUCKETS, BRUTE_FORCE)
    }
    return {"sizes": rows, "growth": {"from": from_size, "to": to_size, **growth}}
