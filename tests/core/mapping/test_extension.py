"""A second teaching drive added to a map: nothing old moves, and the new nodes stand where they were taken."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from omnibotd.core.errors import TrainingError
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.mapping.extension import extend
from omnibotd.core.mapping.topo_map import Dock, DockView, EdgeKind, TopoMap
from omnibotd.core.mapping.training import train
from omnibotd.core.navigation.localization import Localizer
from tests.teaching import CAMERA, Drive, error, frame, waypoint_drive
from tools.sim import ceilings

ELSEWHERE = Pose2D(3.0, -2.0, 2.0)  # where the odometry of the second day starts


@dataclass
class Room:
    origin: Pose2D
    topo_map: TopoMap


def quiet(stage: str, share: float) -> None:
    pass


@pytest.fixture(scope="module")
def room() -> Room:
    drive = waypoint_drive(ceilings.tiles(11), seconds=50.0, half=1.0, seed=1)
    topo_map = train("room", drive.samples, CAMERA, progress=quiet)
    topo_map = topo_map.with_place("desk", Pose2D(0.3, 0.2, 1.0)).with_dock(
        "home", Dock(Pose2D(0.1, 0.1, 0.0), (DockView(b"jpeg"),))
    )
    return Room(drive.truth[0], topo_map)


@pytest.fixture(scope="module")
def second() -> Drive:
    """Another day: lamps off, the base recalibrated by 3 %."""
    world = ceilings.tiles(11, light="lamps_off")
    return waypoint_drive(world, seconds=35.0, half=1.0, seed=2, scale=1.03, odom=ELSEWHERE)


@pytest.fixture(scope="module")
def grown(room: Room, second: Drive) -> TopoMap:
    return extend(room.topo_map, second.samples, CAMERA, progress=quiet)


def errors(room: Room, grown: TopoMap, drive: Drive) -> list[float]:
    """How far each new node is from the nearest true pose of the drive that is headed the same way."""
    truth = [room.origin.inverse() @ pose for pose in drive.truth]
    new = [grown.pose(node) for node in range(len(room.topo_map), len(grown))]
    return [min(node.distance(pose) for pose in truth if abs(wrap(node.yaw - pose.yaw)) < 0.15) for node in new]


def test_nothing_old_changes(room: Room, grown: TopoMap) -> None:
    old, known = room.topo_map, len(room.topo_map)
    for name in ("poses", "snapshots", "sessions"):
        np.testing.assert_array_equal(getattr(grown, name)[:known], getattr(old, name))
    links = len(old.edges)
    for name in ("first", "second", "kind"):
        np.testing.assert_array_equal(getattr(grown.edges, name)[:links], getattr(old.edges, name))
    assert (grown.places, grown.docks, grown.name) == (old.places, old.docks, old.name)


def test_the_new_nodes_stand_where_they_were_taken(room: Room, grown: TopoMap, second: Drive) -> None:
    assert len(grown) - len(room.topo_map) > 50
    off = errors(room, grown, second)
    assert np.median(off) < 0.06
    assert max(off) < 0.2


def test_the_index_and_the_numbers_are_of_the_whole(room: Room, grown: TopoMap, second: Drive) -> None:
    known = len(room.topo_map)
    assert grown.sessions[known:].tolist() == [1] * (len(grown) - known)
    assert grown.units.shape == (len(grown),)
    assert grown.statistics["samples"] == room.topo_map.statistics["samples"] + len(second.samples)
    driven = sum(a.distance(b) for a, b in zip(second.truth, second.truth[1:], strict=False))
    added = grown.statistics["path_length"] - room.topo_map.statistics["path_length"]
    assert added == pytest.approx(1.03 * driven, rel=0.05)


def test_old_and_new_are_linked(room: Room, grown: TopoMap) -> None:
    known, edges = len(room.topo_map), grown.edges
    between = (np.minimum(edges.first, edges.second) < known) & (np.maximum(edges.first, edges.second) >= known)
    assert (edges.kind[between] == EdgeKind.ODOMETRY).sum() == 0
    assert (edges.kind[between] == EdgeKind.SIMILARITY).sum() > 50
    assert (edges.kind == EdgeKind.ODOMETRY).sum() == len(grown) - 2
    pairs = np.sort(np.column_stack([edges.first, edges.second]), 1)
    assert len(np.unique(pairs, axis=0)) == len(edges)


@pytest.mark.parametrize("light", ["nominal", "lamps_off"])
def test_both_lights_are_known(room: Room, grown: TopoMap, light: str) -> None:
    world, localizer, found = ceilings.tiles(11, light=light), Localizer(grown, CAMERA), 0
    rng = np.random.default_rng(4)
    for number in range(15):
        truth = Pose2D(*rng.uniform(-0.8, 0.8, 2), rng.uniform(-3.1, 3.1))
        localizer.reset()
        estimate = localizer.update(frame(world, truth, float(number)), Pose2D())
        found += error(estimate.map_from_base, truth, room.origin)[0] < 0.25
    assert found >= 12


def test_a_new_corner_joins(room: Room) -> None:
    drive = waypoint_drive(ceilings.tiles(11), seconds=60.0, half=0.8, seed=5, centre=(1.1, 0.0), odom=ELSEWHERE)
    grown = extend(room.topo_map, drive.samples, CAMERA, progress=quiet)
    off = errors(room, grown, drive)
    outside = grown.poses[len(room.topo_map) :, :2] - room.topo_map.poses[:, None, :2]
    assert np.hypot(*outside.T).min(1).max() > 0.5  # it does leave the old map
    assert np.median(off) < 0.08
    assert max(off) < 0.25


def test_the_same_drive_gives_the_same_map(room: Room, second: Drive, grown: TopoMap) -> None:
    again = extend(room.topo_map, iter(second.samples), CAMERA, progress=quiet)
    np.testing.assert_allclose(again.poses, grown.poses, atol=1e-4)
    np.testing.assert_array_equal(again.snapshots, grown.snapshots)


def test_another_room_is_refused(room: Room) -> None:
    drive = waypoint_drive(ceilings.tiles(14), seconds=35.0, half=1.0, seed=2)
    with pytest.raises(TrainingError, match=r"recognised in the map.*--fresh|nearly alike.*--fresh"):
        extend(room.topo_map, drive.samples, CAMERA, progress=quiet)


def test_a_map_that_repeats_itself_is_not_joined(room: Room, second: Drive) -> None:
    """The same room twice, side by side: as a building with two equal floors would be."""
    old = room.topo_map
    shifted = old.poses + np.array([4.0, 1.0, 0.0], np.float32)
    twice = replace(
        old,
        poses=np.concatenate([old.poses, shifted]),
        snapshots=np.tile(old.snapshots, (2, 1)),
        units=np.tile(old.units, 2),
        sessions=np.tile(old.sessions, 2),
    )
    with pytest.raises(TrainingError, match="two places of the map nearly alike"):
        extend(twice, second.samples, CAMERA, progress=quiet)


def test_another_camera_is_refused(room: Room, second: Drive) -> None:
    other = replace(CAMERA, tilt=(0.0, math.radians(6.0)))
    with pytest.raises(TrainingError, match="tilt_y"):
        extend(room.topo_map, second.samples, other, progress=quiet)
