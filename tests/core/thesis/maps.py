"""Maps of method thesis made by hand: a chain of nodes with made-up responses."""

import numpy as np

from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.thesis.responses import pack

ODOMETRY, SIMILARITY = EdgeKind.ODOMETRY, EdgeKind.SIMILARITY


def made_map(
    poses: list[tuple[float, float, float]],
    links: list[tuple[int, int, EdgeKind]],
    responses: np.ndarray | None = None,
    threshold: float = 10.0,
) -> TopoMap:
    """Responses (N, 4) of a 2 x 2 SOM, default all different; the winner is the least of them."""
    if responses is None:
        responses = 5.0 + np.arange(4 * len(poses)).reshape(-1, 4) % 7
    first, second, kind = zip(*links, strict=True)
    return TopoMap(
        name="made",
        codebook=np.zeros((4, 6), np.float32),
        units=responses.argmin(1).astype(np.uint16),
        snapshots=pack(responses.astype(np.float32)),
        poses=np.array(poses, np.float32),
        sessions=np.zeros(len(poses), np.uint16),
        edges=Edges(np.array(first, np.int32), np.array(second, np.int32), np.array(kind, np.uint8)),
        statistics={"similarity_threshold": threshold},
        method="thesis",
    )


def chain(points: list[tuple[float, float]]) -> TopoMap:
    """Nodes driven one after the other."""
    poses = [(x, y, 0.0) for x, y in points]
    return made_map(poses, [(k, k + 1, ODOMETRY) for k in range(len(points) - 1)])
