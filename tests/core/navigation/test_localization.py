"""Localisation in a map taught under a simulated ceiling; truth is the simulator's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.mapping.training import train
from omnibotd.core.navigation.certainty import SURE
from omnibotd.core.navigation.localization import Localizer
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.vision.frame import Frame
from tests.teaching import CAMERA, DT, error, frame, waypoint_drive, waypoints
from tools.sim import ceilings, reporting
from tools.sim.conditions import lens_of
from tools.sim.world import World


@dataclass
class Room:
    world: World
    origin: Pose2D
    topo_map: TopoMap


@pytest.fixture(scope="module")
def room() -> Room:
    world = ceilings.tiles(5)
    drive = waypoint_drive(world, seconds=60.0, half=1.0, seed=1)
    topo_map = train("room", drive.samples, CAMERA, progress=lambda stage, share: None)
    return Room(world, drive.truth[0], topo_map)


def follow(room: Room, localizer: Localizer, truth: list[Pose2D], odom: Pose2D, seed: int = 0) -> list[PlaceEstimate]:
    """Estimates along a path, from the odometry pose `odom` on, with 2 % of noise on every step."""
    rng = np.random.default_rng(seed)
    estimates = []
    for number, pose in enumerate(truth):
        if number:
            step = truth[number - 1].inverse() @ pose
            noisy = 1.0 + 0.02 * rng.standard_normal()
            odom = odom @ Pose2D(step.x * noisy, step.y * noisy, step.yaw * noisy)
        estimates.append(localizer.update(frame(room.world, pose, 100.0 + number * DT), odom))
    return estimates


def errors(room: Room, estimates: list[PlaceEstimate], truth: list[Pose2D]) -> tuple[np.ndarray, np.ndarray]:
    pairs = [error(e.map_from_base, t, room.origin) for e, t in zip(estimates, truth, strict=True)]
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


def test_tracks_within_centimetres_and_knows_it(room: Room) -> None:
    truth = waypoints(20.0, 0.9, np.random.default_rng(8))
    estimates = follow(room, Localizer(room.topo_map, CAMERA), truth, Pose2D(3.0, -1.0, 2.0))
    metres, radians = errors(room, estimates, truth)
    confidence = np.array([e.confidence for e in estimates])
    assert np.median(metres[5:]) < 0.05
    assert metres[5:].max() < 0.25
    assert math.degrees(float(np.median(radians[5:]))) < 2.5
    assert (confidence[10:] > SURE).mean() > 0.9
    assert metres[confidence > SURE].max() < 0.25


def test_finds_itself_from_nothing(room: Room) -> None:
    rng = np.random.default_rng(4)
    localizer = Localizer(room.topo_map, CAMERA)
    found = 0
    for number in range(25):
        truth = Pose2D(*rng.uniform(-0.8, 0.8, 2), rng.uniform(-3.1, 3.1))
        localizer.reset()
        estimate = localizer.update(frame(room.world, truth, float(number)), Pose2D())
        metres, _ = error(estimate.map_from_base, truth, room.origin)
        found += metres < 0.25
        assert estimate.confidence < SURE or metres < 0.25
    assert found >= 23


def test_carries_the_frames_stamp_and_odometry(room: Room) -> None:
    odom = Pose2D(1.0, 2.0, 0.5)
    estimate = Localizer(room.topo_map, CAMERA).update(frame(room.world, room.origin, 12.5), odom)
    assert (estimate.stamp, estimate.odom_from_base) == (12.5, odom)
    metres, _ = error(room.topo_map.pose(estimate.node), room.origin, room.origin)
    assert metres < 0.3


def settle(room: Room, localizer: Localizer) -> Pose2D:
    """Drive until sure; returns the true pose at the end. Odometry equals truth here."""
    truth = waypoints(6.0, 0.7, np.random.default_rng(3))
    for number, pose in enumerate(truth):
        estimate = localizer.update(frame(room.world, pose, number * DT), pose)
    assert estimate.confidence > SURE
    return truth[-1]


@pytest.mark.parametrize("kind", ["black", "noise", "elsewhere"])
def test_one_bad_frame_moves_nothing(room: Room, kind: str) -> None:
    localizer = Localizer(room.topo_map, CAMERA)
    truth = settle(room, localizer)
    bad = {
        "black": Frame(50.0, np.zeros((480, 640), np.uint8)),
        "noise": Frame(50.0, np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)),
        "elsewhere": frame(room.world, Pose2D(-truth.x, -truth.y, truth.yaw + 2.0), 50.0),
    }[kind]
    metres, radians = error(localizer.update(bad, truth).map_from_base, truth, room.origin)
    assert metres < 0.25
    assert radians < 0.2
    metres, _ = error(localizer.update(frame(room.world, truth, 50.2), truth).map_from_base, truth, room.origin)
    assert metres < 0.1


def test_a_covered_lens_is_doubted_within_a_second(room: Room) -> None:
    localizer = Localizer(room.topo_map, CAMERA)
    truth = settle(room, localizer)
    covered = [localizer.update(Frame(50.0 + k, np.full((480, 640), 20, np.uint8)), truth) for k in range(5)]
    assert covered[-1].confidence < SURE
    again = [localizer.update(frame(room.world, truth, 60.0 + k), truth) for k in range(15)]
    assert again[-1].confidence > SURE


def test_a_kidnapped_robot_doubts_and_finds_itself(room: Room) -> None:
    localizer = Localizer(room.topo_map, CAMERA)
    before = settle(room, localizer)
    path = waypoints(8.0, 0.8, np.random.default_rng(31))
    assert before.distance(path[0]) > 0.5
    estimates = follow(room, localizer, path, before)
    metres, _ = errors(room, estimates, path)
    confidence = np.array([e.confidence for e in estimates])
    assert ((confidence > SURE) & (metres > 0.25)).sum() <= 2  # 0.4 s
    sure = np.flatnonzero((confidence > SURE) & (metres < 0.15))
    assert len(sure) and sure[0] * DT < 4.0
    assert (confidence[sure[0] :] > SURE).mean() > 0.8


def test_a_place_never_trusted_is_not_kept_for_having_left_the_map(room: Room) -> None:
    """Beyond the nodes nothing speaks against a pose; nothing ever spoke for this one either."""
    localizer, elsewhere = Localizer(room.topo_map, CAMERA), ceilings.tiles(9)
    for number in range(8):
        localizer.update(frame(elsewhere, Pose2D(), number * DT), Pose2D(0.4 * number))
    path = waypoints(4.0, 0.8, np.random.default_rng(31))
    metres, _ = errors(room, follow(room, localizer, path, Pose2D(3.2)), path)
    assert metres[-1] < 0.1


def test_the_place_is_found_where_its_spectrum_is_not(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in another light: the lookup leads elsewhere."""
    path = waypoints(8.0, 0.8, np.random.default_rng(12))
    there = [room.origin.inverse() @ pose for pose in path]
    nodes = room.topo_map.poses[:, :2].astype(float)
    far = np.flatnonzero([min(math.dist(node, (pose.x, pose.y)) for pose in there) > 0.6 for node in nodes])
    assert len(far) > 20
    localizer = Localizer(room.topo_map, CAMERA)
    monkeypatch.setattr(localizer._index, "alike", lambda spectrum, count: far[:count])
    metres, _ = errors(room, follow(room, localizer, path, Pose2D()), path)
    assert metres[round(1.0 / DT)] < 0.1


def test_another_room_is_not_mistaken_for_this_one(room: Room) -> None:
    other = Room(ceilings.plain(77), room.origin, room.topo_map)
    truth = waypoints(15.0, 1.0, np.random.default_rng(5))
    estimates = follow(other, Localizer(room.topo_map, CAMERA), truth, Pose2D())
    assert max(e.confidence for e in estimates) < SURE


def test_reset_forgets(room: Room) -> None:
    localizer = Localizer(room.topo_map, CAMERA)
    settle(room, localizer)
    localizer.reset()
    estimate = localizer.update(Frame(90.0, np.zeros((480, 640), np.uint8)), Pose2D())
    assert estimate.confidence == 0.0


def test_the_other_half_of_a_symmetric_room_is_not_mistaken_for_the_taught_one() -> None:
    """Half a turn round the middle of this gallery all but the walls is the same."""
    world = reporting.gallery(8)
    camera = lens_of(world)
    drive = waypoint_drive(world, seconds=120.0, half=0.9, seed=1, centre=(-0.9, 0.0))
    half = train("half", drive.samples, camera, progress=lambda stage, share: None)
    localizer, steps = Localizer(half, camera), waypoints(60.0, 0.7, np.random.default_rng(3))
    truth = [Pose2D(pose.x + 1.3, pose.y, pose.yaw) for pose in steps]
    estimates = follow(Room(world, drive.truth[0], half), localizer, truth, Pose2D())
    assert max(estimate.score for estimate in estimates) > 0.65
    assert max(estimate.confidence for estimate in estimates) < SURE
