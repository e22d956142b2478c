"""Fewer nodes: the cap holds, the floor stays covered and connected in every light, places keep their nodes."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from omnibotd.core.errors import MapError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.edges import make_edges
from omnibotd.core.mapping.links import Links
from omnibotd.core.mapping.pruning import prune
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.navigation.floor import DrivenFloor
from omnibotd.core.vision.view import RINGS, SECTORS

SIDE = 3.0  # m


def looks(rng: np.random.Generator) -> np.ndarray:
    """Amplitudes (RINGS, SECTORS, 2, 2) of smooth views: two waves across the floor in every cell."""
    return rng.normal(size=(RINGS, SECTORS, 2, 2)).astype(np.float32)


def views_at(positions: np.ndarray, look: np.ndarray) -> np.ndarray:
    phase = np.column_stack([np.ones(len(positions)), 0.5 * positions[:, 0]])
    raw = np.einsum("rsab,na,nb->nrs", look, phase, np.column_stack([np.ones(len(positions)), 0.5 * positions[:, 1]]))
    spread = raw.std((1, 2), keepdims=True)
    return ((raw - raw.mean((1, 2), keepdims=True)) / spread).astype(np.float32)


def lanes(spacing: float, offset: float) -> np.ndarray:
    """Poses of a boustrophedon drive, a node every 8 cm."""
    along = np.arange(0.0, SIDE, 0.08)
    rows = np.arange(offset, SIDE, spacing)
    path = [np.column_stack([along[:: 1 - 2 * (k % 2)], np.full(len(along), y)]) for k, y in enumerate(rows)]
    xy = np.concatenate(path)
    return np.column_stack([xy, np.zeros(len(xy))])


def taught(lights: tuple[int, ...] = (0,), spacing: float = 0.25) -> TopoMap:
    """One drive a light given; the same number is the same light."""
    drives = [lanes(spacing, 0.02 * k) for k in range(len(lights))]
    poses = np.concatenate(drives)
    looks_of = {light: looks(np.random.default_rng(light)) for light in lights}
    views = np.concatenate(
        [views_at(drive[:, :2], looks_of[light]) for drive, light in zip(drives, lights, strict=True)]
    )
    sessions = np.repeat(np.arange(len(lights)), [len(drive) for drive in drives]).astype(np.uint16)
    found = make_edges(poses, Links())
    within = (found.kind != EdgeKind.ODOMETRY) | (sessions[found.first] == sessions[found.second])
    return TopoMap(
        name="hall",
        codebook=np.zeros((4, 192), np.float32),
        units=np.arange(len(poses)).astype(np.uint16) % 4,
        snapshots=snapshots.pack(views),
        poses=poses.astype(np.float32),
        sessions=sessions,
        edges=Edges(found.first[within], found.second[within], found.kind[within]),
        statistics={"samples": 5.0, "odometry_links": -1.0},
    )


def parts(topo_map: TopoMap) -> int:
    edges, nodes = topo_map.edges, len(topo_map)
    links = coo_matrix((np.ones(len(edges)), (edges.first, edges.second)), shape=(nodes, nodes))
    return int(connected_components(links, directed=False)[0])


def farthest(topo_map: TopoMap, positions: np.ndarray, session: int | None = None) -> float:
    """The greatest distance of `positions` from the nearest node of the map (of a session)."""
    mine = topo_map.poses[:, :2] if session is None else topo_map.poses[topo_map.sessions == session, :2]
    return float(np.hypot(*(positions[:, None] - mine[None]).transpose(2, 0, 1)).min(1).max())


def test_a_map_within_the_cap_stays_as_it_is() -> None:
    topo_map = taught()
    assert prune(topo_map, len(topo_map)) is topo_map


@pytest.mark.parametrize("share", [0.6, 0.4, 0.3])
def test_the_cap_holds_and_the_floor_stays_covered_and_connected(share: float) -> None:
    topo_map = taught()
    pruned = prune(topo_map, int(share * len(topo_map)))
    assert len(pruned) == int(share * len(topo_map))
    assert farthest(pruned, topo_map.poses[:, :2]) < 0.26
    assert parts(pruned) == 1
    assert DrivenFloor(pruned.poses[:, :2]).contains(topo_map.poses[:, :2].astype(np.float64)).all()


def test_what_stays_is_what_was() -> None:
    topo_map = taught()
    pruned = prune(topo_map, 200)
    rows = {pose.tobytes(): node for node, pose in enumerate(topo_map.poses)}
    kept = [rows[pose.tobytes()] for pose in pruned.poses]
    assert kept == sorted(kept)
    np.testing.assert_array_equal(pruned.snapshots, topo_map.snapshots[kept])
    np.testing.assert_array_equal(pruned.units, topo_map.units[kept])
    assert {0, len(topo_map) - 1} <= set(kept)


def test_nodes_get_even() -> None:
    """Along a straight line of 8 cm steps half the nodes: every other, so no two neighbours are left."""
    topo_map = taught(spacing=SIDE)
    pruned = prune(topo_map, len(topo_map) // 2 + 1)
    gaps = np.diff(pruned.poses[:, 0])
    assert gaps.max() < 0.25
    assert np.median(gaps) == pytest.approx(0.16, abs=0.01)


def test_links_join_the_nodes_beside_one_that_went() -> None:
    pruned = prune(taught(spacing=SIDE), 20)
    edges = pruned.edges
    assert {(k, k + 1) for k in range(len(pruned) - 1)} <= set(
        zip(edges.first.tolist(), edges.second.tolist(), strict=True)
    )
    assert (edges.first < edges.second).all()
    assert len(np.unique(np.column_stack([edges.first, edges.second]), axis=0)) == len(edges)
    assert pruned.statistics["odometry_links"] == (edges.kind == EdgeKind.ODOMETRY).sum()
    assert pruned.statistics["samples"] == 5.0


def test_every_light_keeps_its_floor() -> None:
    topo_map = taught((0, 1))
    pruned = prune(topo_map, 400)
    for session in (0, 1):
        floor = topo_map.poses[topo_map.sessions == session, :2]
        assert farthest(pruned, floor, session) < 0.26


def test_another_drive_in_the_same_light_is_the_first_to_go() -> None:
    same, other = prune(taught((0, 0)), 250), taught((0, 1))
    assert farthest(same, taught((0, 0)).poses[:, :2]) < 0.26
    with pytest.raises(MapError, match=r"can't do with 250 nodes: \d+ are needed"):
        prune(other, 250)


def test_places_keep_the_nodes_about_them() -> None:
    topo_map = taught().with_place("desk", Pose2D(1.5, 1.5, 0.0))
    apart = np.sort(np.hypot(topo_map.poses[:, 0] - 1.5, topo_map.poses[:, 1] - 1.5))
    pruned = prune(topo_map, 200)
    left = np.sort(np.hypot(pruned.poses[:, 0] - 1.5, pruned.poses[:, 1] - 1.5))
    np.testing.assert_allclose(left[:5], apart[:5])


def test_the_same_map_prunes_the_same() -> None:
    first, second = prune(taught((0, 1)), 500), prune(taught((0, 1)), 500)
    np.testing.assert_array_equal(first.poses, second.poses)
    np.testing.assert_array_equal(first.edges.first, second.edges.first)


def test_a_large_map_takes_seconds() -> None:
    topo_map = taught((0, 0), spacing=0.012)
    assert len(topo_map) > 18_000
    began = time.process_time()
    assert len(prune(topo_map, 4000)) == 4000
    assert time.process_time() - began < 15.0
