"""A map of the thesis' method as large as one likes, in seconds."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.som import Som
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.thesis import links
from omnibotd.core.thesis.responses import pack
from omnibotd.core.thesis.vector import Perceiver
from omnibotd.core.vision.frame import Frame
from tools.benchmark import rooms

Floats = NDArray[np.floating]

SPACING = 0.2  # m between nodes: one a second at 0.2 m/s
NOISE = 0.3  # of two looks at one place, as a share of what a step changes
# What the thesis' own code is asked to do in a cycle, stage by stage.
_THESIS = "omnibotd.core.thesis."
STAGES: Mapping[str, tuple[str, ...]] = {
    "decode in colour": (_THESIS + "compass:decode_colour",),
    "undistort": (_THESIS + "compass:Undistortion.__call__",),
    "tile compass": (_THESIS + "compass:Compass.read",),
    "gradient": (_THESIS + "vector:gradient_magnitude",),
    "7986 samples": (_THESIS + "vector:sample_circles",),
    "100 full comparisons": (_THESIS + "responses:Classifier.__call__",),
    "bucket": (_THESIS + "localizer:ThesisLocalizer.update",),
    "uniform-cost search": (_THESIS + "route:Route.__init__",),
    "filter and dynamic window": (_THESIS + "navigator:ThesisNavigator.step",),
}


@functools.cache
def perceptions(count: int) -> tuple[Floats, Floats]:
    """(count, 7986) perception vectors along a drive with the thesis' spacing, and their poses (count, 3)."""
    poses = rooms.waypoints(count, SPACING, rooms.SEED)
    perceiver = Perceiver(rooms.CAMERA)
    seen = [
        perceiver.perceive(Frame(0.0, jpeg), Pose2D(*pose))
        for pose, jpeg in zip(poses, rooms.jpegs(poses, 1.0), strict=True)
    ]
    known = [k for k, perception in enumerate(seen) if perception is not None]
    return np.array([seen[k].vector for k in known], np.float32), poses[known]


def thesis_map(nodes: int, count: int) -> TopoMap:
    """A thesis map of `nodes` nodes from `count` real perceptions.

    The drive is repeated until there are enough nodes, each time by another fraction of a step ahead; such nodes have
    responses between those of the real ones, with the noise of two looks at one place.
    """
    vectors, driven = perceptions(min(count, nodes))
    som = Som.train(vectors)
    responses, poses = repeated(som.distances(vectors), driven, nodes)
    units = responses.argmin(1).astype(np.uint16)
    threshold = links.similarity_threshold(responses)
    similar = links.similar_pairs(responses, units, threshold)
    odometry = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)])
    pairs = np.concatenate([odometry, similar]).astype(np.int32)
    kinds = np.repeat([EdgeKind.ODOMETRY, EdgeKind.SIMILARITY], [len(odometry), len(similar)])
    return TopoMap(
        name=f"thesis, {nodes} nodes",
        codebook=som.codebook,
        units=units,
        snapshots=pack(responses),
        poses=poses.astype(np.float32),
        sessions=np.zeros(nodes, np.uint16),
        edges=Edges(pairs[:, 0], pairs[:, 1], kinds.astype(np.uint8)),
        statistics={links.THRESHOLD: threshold},
        method="thesis",
    )


def repeated(responses: Floats, poses: Floats, nodes: int) -> tuple[Floats, Floats]:
    """(nodes, units) responses and (nodes, 3) poses of so many nodes on ever other passes of the same drive."""
    rng = np.random.default_rng(rooms.SEED)
    steps = len(responses) - 1
    lap, step = np.divmod(np.arange(nodes), steps)
    ahead = rng.uniform(0.0, 1.0, lap[-1] + 1)[lap][:, None]
    line = responses[step] * (1.0 - ahead) + responses[step + 1] * ahead
    line += NOISE * np.linalg.norm(np.diff(responses, axis=0), axis=1).mean() * _unit_noise(rng, line.shape)
    return line.astype(np.float32), poses[step] * (1.0 - ahead) + poses[step + 1] * ahead


def _unit_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Rows of about unit length."""
    return np.asarray(rng.standard_normal(shape, np.float32) / np.sqrt(shape[1]), np.float32)
