"""Action maps: made by hand on a line of places, and by exploring an arena whose bearings are worked out here."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.discrete.action_map import LOOKALIKES, NOTHING, SIDE, ActionMap, Explorer, Locator
from omnibotd.core.discrete.actions import STRIDE, TURN, Action
from omnibotd.core.discrete.navigator import DiscreteNavigator
from omnibotd.core.errors import MapError
from omnibotd.core.geometry import Pose2D

F, B, L, R = Action
CODEBOOK = np.random.default_rng(0).uniform(-math.pi, math.pi, (SIDE * SIDE, 4)).astype(np.float32)
TILES = np.array([(1.5, 1.3), (-1.5, 1.3), (-1.5, -1.3), (1.5, -1.3)])


def place(k: float) -> np.ndarray:
    """A perception that changes along a line."""
    return np.array([0.1 * k, -0.1 * k, 0.2, 0.05 * k])


def line(count: int) -> ActionMap:
    """A drive straight ahead."""
    explorer = Explorer(CODEBOOK)
    node = explorer.look(place(0))
    for k in range(1, count):
        node = explorer.acted(node, F, place(k))
    return explorer.finished()


def bare(made: ActionMap, *alike: tuple[int, int, float]) -> ActionMap:
    """Without its own similarity links, with these (nodes and cost)."""
    driven = made.actions != NOTHING
    first, second, cost = zip(*alike, strict=True) if alike else ((), (), ())
    return replace(
        made,
        first=np.r_[made.first[driven], np.array(first, np.int32)],
        second=np.r_[made.second[driven], np.array(second, np.int32)],
        actions=np.r_[made.actions[driven], np.full(len(alike), NOTHING, np.int8)],
        costs=np.r_[made.costs[driven], np.array(cost)],
    )


def test_actions_undo_each_other() -> None:
    for action in Action:
        back = Pose2D() @ action.move @ action.inverse.move
        assert (back.x, back.y, back.yaw) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert F.move.x == 0.15
    assert L.move.yaw == pytest.approx(math.pi / 4)


def test_nodes_are_found_by_what_was_perceived_there() -> None:
    made = line(20)
    locator = Locator(made)
    assert [locator.node(place(k)) for k in range(20)] == list(range(20))
    assert locator.node(place(7.3)) == 7


def test_links_are_followed_forwards_and_undone_backwards() -> None:
    made = bare(line(8))
    assert DiscreteNavigator(made, 6).step(place(2)).action is F
    assert DiscreteNavigator(made, 1).step(place(5)).action is B
    assert DiscreteNavigator(made, 4).step(place(4)).action is None


def test_three_proven_actions_are_preferred_to_one_guess() -> None:
    made = line(12)
    three, four = bare(made, (0, 3, 3.01)), bare(made, (0, 4, 3.01))
    assert DiscreteNavigator(three, 3).step(place(0)).action is F
    assert DiscreteNavigator(four, 4).step(place(0)).action is None


def test_similarity_links_on_the_way_cost_no_motion() -> None:
    made = bare(line(30), (0, 20, 3.1))
    assert DiscreteNavigator(made, 18).step(place(0)).action is B


def test_without_a_way_it_says_so() -> None:
    explorer = Explorer(CODEBOOK)
    explorer.look(place(0))
    explorer.look(place(30))
    with pytest.raises(MapError, match="no link leads from node 0 to node 1"):
        DiscreteNavigator(bare(explorer.finished()), 1).step(place(0))


def test_a_target_that_is_not_there_is_refused() -> None:
    with pytest.raises(MapError, match="no node 9"):
        DiscreteNavigator(line(3), 9)


def test_a_map_of_nothing_is_refused() -> None:
    with pytest.raises(MapError, match="four tiles"):
        Explorer(CODEBOOK).finished()


def seen_from(pose: Pose2D) -> np.ndarray:
    dx, dy = (TILES - (pose.x, pose.y)).T
    return np.angle(np.exp(1j * (np.arctan2(dy, dx) - pose.yaw)))


def explored(count: int, rng: np.random.Generator) -> tuple[ActionMap, list[Pose2D]]:
    """A walk of exact actions, all headings multiples of 45 degrees, in a square of 1.8 m."""
    explorer, pose = Explorer(CODEBOOK), Pose2D()
    node, poses, last = explorer.look(seen_from(pose)), [pose], None
    while len(poses) <= count:
        action = Action(int(rng.integers(4)))
        ahead = pose @ action.move
        if max(abs(ahead.x), abs(ahead.y)) > 0.9 or (last is not None and action is last.inverse):
            continue
        pose, last = ahead, action
        node = explorer.acted(node, action, seen_from(pose))
        poses.append(pose)
    return explorer.finished(), poses


def test_nodes_get_a_few_lookalikes_that_are_close_by() -> None:
    made, poses = explored(1500, np.random.default_rng(1))
    alike = made.actions == NOTHING
    assert 2 * alike.sum() / len(made) == pytest.approx(LOOKALIKES, abs=0.5)
    apart = [poses[a].distance(poses[b]) for a, b in zip(made.first[alike], made.second[alike], strict=True)]
    assert np.median(apart) < STRIDE
    assert (made.costs[alike] >= 3.0).all()
    assert (made.costs[alike] <= 3.0 + made.threshold).all()


def test_it_gets_nearer_the_goal_from_everywhere() -> None:
    """With turns that err by a degree and strides by 3 mm, as the simulated robot's do."""
    rng = np.random.default_rng(2)
    made, _ = explored(1500, rng)
    goal = Pose2D(-0.5, 0.4, math.pi / 2)
    navigator = DiscreteNavigator(made, Locator(made).node(seen_from(goal)))
    ends = []
    for start in (Pose2D(0.7, -0.7, 0.0), Pose2D(0.6, 0.5, math.pi), Pose2D(-0.6, -0.7, TURN), Pose2D()):
        pose = start
        for _ in range(200):
            action = navigator.step(seen_from(pose)).action
            if action is None:
                break
            pose = pose @ action.move @ Pose2D(0.003 * rng.standard_normal(), 0.0, 0.0)
            heading = round(pose.yaw / TURN) * TURN + math.radians(1.0) * rng.standard_normal()
            pose = Pose2D(pose.x, pose.y, heading)
        ends.append((pose.distance(goal), start.distance(goal)))
    assert all(end < start for end, start in ends)
    assert np.median([end for end, _ in ends]) < 0.2
