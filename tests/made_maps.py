"""Maps made of nothing: what a store, a client or a request needs, without a drive."""

from __future__ import annotations

import numpy as np

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.topo_map import Dock, DockView, EdgeKind, Edges, TopoMap
from omnibotd.core.vision.view import RINGS, SECTORS


def made_map(name: str = "flat", nodes: int = 60, seed: int = 1) -> TopoMap:
    """Nodes every 10 cm along x, each linked to the next, with views of noise; a place at either end and a dock."""
    rng = np.random.default_rng(seed)
    poses = np.zeros((nodes, 3), np.float32)
    poses[:, 0] = np.arange(nodes) * 0.1
    first = np.arange(nodes - 1, dtype=np.int32)
    return TopoMap(
        name=name,
        codebook=rng.normal(size=(16, 192)).astype(np.float32),
        units=rng.integers(0, 16, nodes).astype(np.uint16),
        snapshots=snapshots.pack(rng.normal(size=(nodes, RINGS, SECTORS)).astype(np.float32)),
        poses=poses,
        sessions=(np.arange(nodes) >= nodes // 3).astype(np.uint16),
        edges=Edges(first, first + 1, np.full(nodes - 1, EdgeKind.ODOMETRY, np.uint8)),
        ceiling_height=2.2,
        recordings=(f"{name}.0001.mcap", f"{name}.0002.mcap"),
        statistics={"quantization_error": 0.125},
        places={"desk": Pose2D(), "sofa": Pose2D((nodes - 1) * 0.1, 0.0, 3.0)},
        docks={"home": Dock(Pose2D(1.0, 0.0), (DockView(b"\xff\xd8" + rng.bytes(500) + b"\xff\xd9"),))},
    )
