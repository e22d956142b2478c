"""Routes: right, shortest, and searched a little at a time; nodes found by where they are."""

import heapq
import math

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.navigation.floor import DrivenFloor
from omnibotd.core.navigation.node_grid import NodeGrid
from omnibotd.core.navigation.planning import HOP_COST, Roads, Route, roads_of


def map_of(poses: np.ndarray, links: np.ndarray) -> TopoMap:
    first, second = links.astype(np.int32).T
    edges = Edges(first, second, np.full(len(first), EdgeKind.PROXIMITY, np.uint8))
    count = len(poses)
    codebook, units = np.zeros((1, 192), np.float32), np.zeros(count, np.uint16)
    snapshots, sessions = np.zeros((count, 512), np.uint8), np.zeros(count, np.uint16)
    return TopoMap("scattered", codebook, units, snapshots, poses.astype(np.float32), sessions, edges)


def scattered(count: int, side: float, seed: int, reach: float = 0.35) -> TopoMap:
    """Nodes anywhere in a square, linked within `reach` metres."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, side, (count, 2))
    apart = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    links = np.argwhere(np.triu((apart < reach) & (apart > 0.0)))
    return map_of(np.column_stack([points, np.zeros(count)]), links)


def costs_by_dijkstra(topo_map: TopoMap, goal: int, floor: DrivenFloor) -> list[float]:
    """One node after another, as in a textbook."""
    points = topo_map.poses[:, :2].astype(float)
    around: dict[int, list[int]] = {k: [] for k in range(len(points))}
    for a, b in zip(topo_map.edges.first.tolist(), topo_map.edges.second.tolist(), strict=True):
        around[a].append(b)
        around[b].append(a)
    costs, queue = [math.inf] * len(points), [(0.0, goal)]
    while queue:
        cost, node = heapq.heappop(queue)
        if cost >= costs[node]:
            continue
        costs[node] = cost
        for other in around[node]:
            free = floor.contains(np.array([points[other], (points[node] + points[other]) / 2.0])).all()
            if free:
                heapq.heappush(queue, (cost + float(np.hypot(*(points[other] - points[node]))) + HOP_COST, other))
    return costs


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("nodes_a_call", [1, 40, None])
def test_costs_are_those_of_dijkstra_however_the_search_is_cut(seed: int, nodes_a_call: int | None) -> None:
    topo_map = scattered(400, 3.0, seed)
    roads = Roads(topo_map)
    floor = roads.floor.copy()
    floor.block(1.5, 1.5, 0.5)
    goal = roads.grid.nearest(0.3, 0.3)
    route = Route(roads, topo_map.pose(goal), floor)
    while not route.advance(nodes_a_call):
        pass
    assert route._cost == pytest.approx(costs_by_dijkstra(topo_map, goal, floor))


def test_what_is_known_early_is_what_will_be_known_at_the_end() -> None:
    topo_map = scattered(3000, 8.0, 1)
    roads = Roads(topo_map)
    floor = roads.floor.copy()
    for y in np.arange(1.0, 9.0, 0.1):
        floor.block(2.5, float(y), 0.15)
    route = Route(roads, Pose2D(1.5, 7.0), floor)
    near, far = Pose2D(1.0, 5.0), Pose2D(7.5, 7.0)
    asked = {near: [], far: []}
    done = False
    while not done:
        done = route.advance(100)
        for pose, distances in asked.items():
            if route.known(pose):
                distances.append(route.distance(pose))
    assert len(asked[near]) > len(asked[far]) > 0
    for distances in asked.values():
        assert distances == [distances[0]] * len(distances)


def test_a_call_expands_no_more_than_a_batch_beyond_what_it_is_allowed() -> None:
    roads = Roads(scattered(3000, 8.0, 1))
    route = Route(roads, Pose2D(4.0, 4.0), roads.floor.copy())
    calls = 1
    while not route.advance(256):
        calls += 1
    assert calls >= 3000 // 512


def test_the_carrot_is_in_sight_and_leads_round() -> None:
    roads = Roads(scattered(1500, 5.0, 2))
    floor = roads.floor.copy()
    for y in np.arange(0.8, 6.0, 0.1):
        floor.block(2.5, float(y), 0.15)
    goal, here = Pose2D(4.5, 4.5), Pose2D(0.5, 4.5)
    route = Route(roads, goal, floor)
    route.advance()
    assert not floor.straight(here, goal)
    corners = [here]
    while corners[-1] != goal:
        carrot = route.carrot(corners[-1])
        assert carrot is not None
        assert floor.straight(corners[-1], carrot)
        corners.append(carrot)
        assert len(corners) < 20
    assert min(pose.y for pose in corners) < 0.8


@pytest.mark.parametrize("seed", range(3))
def test_nodes_near_by_are_those_that_a_scan_of_all_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3.0, 5.0, (500, 2))
    grid = NodeGrid(points)
    for x, y in rng.uniform(-5.0, 8.0, (100, 2)):
        away = np.hypot(*(points - (x, y)).T)
        for radius in (0.1, 0.3, 0.9):
            assert sorted(grid.near(x, y, radius)) == np.flatnonzero(away <= radius).tolist()
            nodes, squares = grid.within(x, y, radius)
            np.testing.assert_allclose(np.sqrt(squares), away[nodes])
        assert grid.nearest(x, y) == int(away.argmin())
    assert grid.nearest(100.0, 100.0) == int(np.hypot(*(points - 100.0).T).argmin())


def test_roads_are_kept_while_only_places_change() -> None:
    topo_map = scattered(50, 1.0, 0)
    roads = roads_of(topo_map)
    assert roads_of(topo_map.with_place("desk", Pose2D())) is roads
    assert roads_of(scattered(50, 1.0, 0)) is not roads


def test_a_trips_own_floor_leaves_the_maps_floor_alone() -> None:
    floor = DrivenFloor(np.array([[0.0, 0.0], [1.0, 0.0]], np.float32))
    own = floor.copy()
    own.block(0.0, 0.0, 0.2)
    own.open(0.5, 0.5, 0.1)
    points = np.array([[0.0, 0.0], [0.5, 0.5]])
    assert own.contains(points).tolist() == [False, True]
    assert floor.contains(points).tolist() == [True, False]


def test_floor_is_what_lies_within_the_corridor_of_a_node() -> None:
    nodes = np.array([[0.0, 0.0], [2.0, 1.0]])
    floor = DrivenFloor(nodes.astype(np.float32))
    points = np.random.default_rng(0).uniform(-1.5, 3.5, (2000, 2))
    away = np.hypot(*(points[:, None] - nodes[None]).transpose(2, 0, 1)).min(1)
    inside = floor.contains(points)
    assert inside[away < 0.3 - 0.075].all()
    assert not inside[away > 0.3 + 0.075].any()
