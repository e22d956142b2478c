"""A map from a simulated teaching drive, and what training refuses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from omnibotd.core.errors import TrainingError
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.topo_map import EdgeKind, TopoMap
from omnibotd.core.mapping.training import TeachingSample, train
from omnibotd.core.vision.frame import Frame
from tests.teaching import CAMERA, Drive, waypoint_drive
from tools.sim import ceilings


@dataclass
class Taught:
    drive: Drive
    topo_map: TopoMap
    progress: list[tuple[str, float]]


@pytest.fixture(scope="module")
def taught() -> Taught:
    drive = waypoint_drive(ceilings.plain(3), seconds=50.0, half=1.0, seed=2, scale=1.03)
    progress: list[tuple[str, float]] = []
    topo_map = train("room", drive.samples, CAMERA, progress=lambda stage, share: progress.append((stage, share)))
    return Taught(drive, topo_map, progress)


def true_nodes(taught: Taught, scale: float = 1.0) -> list[Pose2D]:
    """Which true pose each node was taken at: the one whose odometry it fits best, in order."""
    truth, start = [], 0
    for node in range(len(taught.topo_map)):
        view = taught.topo_map.pose(node)
        view = Pose2D(view.x / scale, view.y / scale, view.yaw)
        candidates = range(start, min(start + 12, len(taught.drive.truth)))
        origin = taught.drive.truth[0]
        start = min(candidates, key=lambda k: _apart(origin.inverse() @ taught.drive.truth[k], view))
        truth.append(origin.inverse() @ taught.drive.truth[start])
    return truth


def _apart(a: Pose2D, b: Pose2D) -> float:
    return a.distance(b) + 0.3 * abs(wrap(a.yaw - b.yaw))


def test_nodes_stand_where_they_were_taken(taught: Taught) -> None:
    truth = true_nodes(taught)
    scaled = [Pose2D(1.03 * p.x, 1.03 * p.y, p.yaw) for p in truth]
    errors = [taught.topo_map.pose(k).distance(p) for k, p in enumerate(scaled)]
    turns = [abs(wrap(taught.topo_map.pose(k).yaw - p.yaw)) for k, p in enumerate(scaled)]
    assert np.median(errors) < 0.06
    assert max(errors) < 0.2
    assert math.degrees(float(np.median(turns))) < 2.0


def test_the_map_starts_at_its_origin(taught: Taught) -> None:
    assert np.abs(taught.topo_map.poses[0]).max() < 1e-3
    assert np.abs(taught.topo_map.poses[:, 2]).max() <= math.pi + 1e-6


@pytest.mark.parametrize(("scale", "veer"), [(1.1, 0.0), (1.0, math.radians(5.0))])
def test_odometry_that_is_long_or_veers_makes_the_same_map(scale: float, veer: float) -> None:
    drive = waypoint_drive(ceilings.plain(3), seconds=40.0, half=1.0, seed=2, scale=scale, veer=veer)
    topo_map = train("room", drive.samples, CAMERA, progress=lambda stage, share: None)
    wheels = drive.samples[-1].odom_from_base
    scaled = Pose2D(wheels.x / scale, wheels.y / scale, wheels.yaw)
    straight = drive.truth[0].inverse() @ drive.truth[-1]
    if veer:
        assert abs(wrap(scaled.yaw - straight.yaw)) > math.radians(30.0)
    for node, pose in enumerate(true_nodes(Taught(drive, topo_map, []), scale)):
        assert topo_map.pose(node).distance(Pose2D(scale * pose.x, scale * pose.y)) < 0.2
        assert abs(wrap(topo_map.pose(node).yaw - pose.yaw)) < math.radians(8.0)


def test_shapes_and_types(taught: Taught) -> None:
    topo_map, nodes = taught.topo_map, len(taught.topo_map)
    assert 50 < nodes <= len(taught.drive.samples)
    assert (topo_map.codebook.shape, topo_map.codebook.dtype) == ((100, 192), np.float32)
    assert (topo_map.snapshots.shape, topo_map.snapshots.dtype) == ((nodes, snapshots.BYTES), np.uint8)
    assert (topo_map.units.shape, topo_map.units.dtype) == ((nodes,), np.uint16)
    assert topo_map.units.max() < 100
    assert topo_map.poses.dtype == np.float32


def test_links(taught: Taught) -> None:
    edges, poses = taught.topo_map.edges, taught.topo_map.poses
    pairs = np.sort(np.column_stack([edges.first, edges.second]), 1)
    assert len(np.unique(pairs, axis=0)) == len(edges)
    assert (edges.first != edges.second).all()
    assert (edges.kind == EdgeKind.ODOMETRY).sum() == len(poses) - 1
    assert (edges.kind == EdgeKind.SIMILARITY).sum() > 20
    assert (edges.kind == EdgeKind.PROXIMITY).sum() > 20
    offset = poses[edges.second, :2] - poses[edges.first, :2]
    assert np.hypot(*offset[edges.kind != EdgeKind.ODOMETRY].T).max() < 0.3


def test_statistics(taught: Taught) -> None:
    statistics = taught.topo_map.statistics
    assert statistics["samples"] == len(taught.drive.samples)
    driven = sum(a.distance(b) for a, b in zip(taught.drive.truth, taught.drive.truth[1:], strict=False))
    assert statistics["path_length"] == pytest.approx(1.03 * driven, rel=0.05)
    assert statistics["score_at_home"] > statistics["score_elsewhere"] + 0.1
    assert 0.0 <= statistics["ambiguity"] < 0.2
    assert 0.0 <= statistics["topographic_error"] < 0.5
    assert taught.topo_map.camera["fx"] == CAMERA.fx


def test_the_ceiling_is_measured_in_odometry_metres(taught: Taught) -> None:
    # 2.2 m above the camera, odometry 3 % long; walls in view make it look a little nearer or farther.
    assert taught.topo_map.ceiling_height == pytest.approx(1.03 * 2.2, rel=0.08)


def test_progress_only_grows(taught: Taught) -> None:
    shares = [share for _, share in taught.progress]
    assert shares == sorted(shares)
    assert taught.progress[-1] == ("done", 1.0)


def test_the_same_recording_gives_the_same_map(taught: Taught) -> None:
    samples = taught.drive.samples[:80]
    maps = [train("twice", iter(samples), CAMERA, seed=3, progress=lambda stage, share: None) for _ in range(2)]
    # Threads of the linear algebra may add in another order, no more.
    np.testing.assert_allclose(maps[0].poses, maps[1].poses, atol=1e-4)
    np.testing.assert_allclose(maps[0].codebook, maps[1].codebook, atol=1e-4)
    np.testing.assert_array_equal(maps[0].snapshots, maps[1].snapshots)


def straight(frames: list[Frame], spacing: float) -> list[TeachingSample]:
    return [TeachingSample(0.2 * k, Pose2D(spacing * k, 0.0, 0.0), frame) for k, frame in enumerate(frames)]


def refuse(samples: list[TeachingSample], words: str) -> None:
    with pytest.raises(TrainingError, match=words):
        train("none", samples, CAMERA, progress=lambda stage, share: None)


def test_too_few_samples_are_refused(taught: Taught) -> None:
    refuse([], "0 samples")
    refuse(taught.drive.samples[:10], "10 samples")


def test_a_robot_that_stood_still_is_refused(taught: Taught) -> None:
    refuse(straight([sample.frame for sample in taught.drive.samples[:60]], 0.0), "hardly moved")


def test_frames_without_structure_are_refused() -> None:
    rng = np.random.default_rng(0)
    noise = [Frame(0.2 * k, rng.normal(90, 2, (480, 640)).astype(np.uint8)) for k in range(40)]
    refuse(straight(noise, 0.1), "nothing that lasts")
    black = [Frame(0.2 * k, np.zeros((480, 640), np.uint8)) for k in range(40)]
    refuse(straight(black, 0.1), "lens cap")
