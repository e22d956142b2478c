"""From samples to the thesis' map: which samples are used, what the map holds, and what is refused."""

import math
from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np
import pytest

from omnibotd.core.errors import TrainingError
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.mapping.drive import TeachingSample
from omnibotd.core.mapping.topo_map import EdgeKind, TopoMap
from omnibotd.core.thesis import som
from omnibotd.core.thesis.links import Links
from omnibotd.core.thesis.localizer import ThesisLocalizer
from omnibotd.core.thesis.responses import Classifier, unpack
from omnibotd.core.thesis.training import node_samples, schedule, train_thesis
from omnibotd.core.thesis.vector import Perceiver
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tests.core.thesis.rooms import room_with_tiles

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))
SECONDS, RATE = 52, 5
START = Pose2D(-0.8, -0.6, 0.5)
NOTHING = Frame(0.0, np.zeros((480, 640, 3), np.uint8))


def quiet(stage: str, share: float) -> None:
    pass


def blank(seconds: float, rate: float = RATE) -> Iterator[TeachingSample]:
    """Samples without a picture, for what looks at their stamps alone; they begin at 1000 s."""
    return (TeachingSample(1000.0 + k / rate, Pose2D(), NOTHING) for k in range(round(seconds * rate)))


def truth(stamp: float) -> Pose2D:
    """Round and round at 0.2 m/s on a loop that slowly drifts outwards."""
    angle = 0.25 * stamp
    radius = 0.6 + 0.004 * stamp
    x, y = radius * math.cos(angle), radius * math.sin(angle)
    return Pose2D(x, y, wrap(angle + math.pi / 2))


def sample(stamp: float, frame: Frame) -> TeachingSample:
    """Odometry is exact, in axes that begin at the robot."""
    return TeachingSample(stamp, truth(0.0).inverse() @ truth(stamp), frame)


@cache
def taught() -> tuple[TopoMap, tuple[tuple[str, float], ...]]:
    room, told = room_with_tiles(), []
    stamps = [k / 2 for k in range(2 * SECONDS)]  # the samples between are not looked at
    frames = (Frame(t, room.render(truth(t).x, truth(t).y, truth(t).yaw, t)) for t in stamps)
    samples = (sample(t, frame) for t, frame in zip(stamps, frames, strict=True))
    topo_map = train_thesis("loop", samples, CAMERA, seed=2, progress=lambda stage, share: told.append((stage, share)))
    return topo_map, tuple(told)


@pytest.fixture(autouse=True)
def quick_som(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(som.train, "__kwdefaults__", {**som.train.__kwdefaults__, "epochs": 40})


def test_phase_one_takes_1000_samples_in_500_seconds() -> None:
    uses = list(schedule(blank(600)))
    learning = [use.elapsed for use in uses if use.learn]
    assert len(learning) == 1000
    assert learning[-1] < 500.0
    assert np.diff(learning).max() < 0.7


def test_a_long_drive_makes_a_node_a_second_of_phase_two() -> None:
    nodes = node_samples(blank(1200))
    assert [node.stamp for node in nodes] == pytest.approx(list(range(1500, 2200)))


def test_a_drive_shorter_than_1000_s_makes_nodes_of_both_phases() -> None:
    assert [node.stamp for node in node_samples(blank(620))] == pytest.approx(list(range(1000, 1620)))


def test_a_slow_camera_is_used_as_often_as_it_sees() -> None:
    assert sum(use.learn for use in schedule(blank(40, rate=1.0))) == 40
    assert len(node_samples(blank(40, rate=0.5))) == 20


def test_the_map_is_the_thesis() -> None:
    topo_map, _ = taught()
    assert topo_map.method == "thesis"
    assert topo_map.codebook.shape == (100, 7986)
    assert topo_map.codebook.dtype == np.float32
    assert len(topo_map) == SECONDS
    assert topo_map.snapshots.shape == (SECONDS, 400)
    assert topo_map.snapshots.dtype == np.uint8
    assert (topo_map.units == unpack(topo_map).argmin(1)).all()
    assert topo_map.statistics["som_samples"] == 2 * SECONDS
    assert topo_map.statistics["compass_seen"] == 1.0


def test_responses_are_distances_of_what_was_seen_to_the_units() -> None:
    topo_map, _ = taught()
    pose = truth(10.0)
    picture = room_with_tiles().render(pose.x, pose.y, pose.yaw, 10.0)
    perception = Perceiver(CAMERA).perceive(Frame(0.0, picture), Pose2D())
    assert perception is not None
    expected = np.linalg.norm(topo_map.codebook - perception.vector, axis=1)
    assert unpack(topo_map)[10] == pytest.approx(expected, rel=1e-3, abs=0.01 * float(expected.mean()))


def test_poses_are_dead_reckoned_in_the_compass_axes() -> None:
    """These are the world's: red tile at -x, blue at +x; the origin is where the drive began."""
    topo_map, _ = taught()
    for node in range(SECONDS):
        true, pose = truth(float(node)), topo_map.pose(node)
        assert abs(wrap(pose.yaw - true.yaw)) < math.radians(1.0)
        # A degree of compass error in each step of 0.2 m adds up like a random walk.
        assert math.hypot(pose.x - (true.x - truth(0).x), pose.y - (true.y - truth(0).y)) < 0.08


def test_links_join_what_was_driven_in_succession_and_what_looks_alike() -> None:
    topo_map, _ = taught()
    edges, responses = topo_map.edges, unpack(topo_map)
    driven = edges.kind == EdgeKind.ODOMETRY
    assert np.column_stack([edges.first, edges.second])[driven].tolist() == [[k, k + 1] for k in range(SECONDS - 1)]
    threshold = topo_map.statistics["similarity_threshold"]
    for a, b in zip(edges.first[~driven], edges.second[~driven], strict=True):
        assert topo_map.units[a] == topo_map.units[b]
        assert b - a > 1
        assert np.linalg.norm(responses[a] - responses[b]) < threshold
    assert (Links.of(topo_map).variances <= 0.05).all()


def test_progress_rises_to_one() -> None:
    _, told = taught()
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert told[-1] == ("done", 1.0)
    assert {"reading", "som", "links"} <= {stage for stage, _ in told}


def test_the_localizer_finds_a_node_near_and_the_heading_exactly() -> None:
    topo_map, _ = taught()
    localizer = ThesisLocalizer(topo_map, CAMERA)
    room = room_with_tiles()
    errors = []
    for stamp in np.arange(0.5, 48.0, 4.5):
        pose = truth(float(stamp))
        yaw = wrap(pose.yaw + stamp)  # any way it faces
        place = localizer.update(Frame(stamp, room.render(pose.x, pose.y, yaw, stamp)), Pose2D(1.0, 2.0, 0.3))
        assert abs(wrap(place.map_from_base.yaw - yaw)) < math.radians(1.0)
        assert place.confidence == 1.0
        assert 0.0 <= place.sigma <= math.sqrt(0.05)
        assert place.odom_from_base == Pose2D(1.0, 2.0, 0.3)
        node = truth(float(place.node))
        assert place.map_from_base.x == pytest.approx(topo_map.poses[place.node, 0])
        errors.append(node.distance(pose))
    assert np.median(errors) < 0.15


def test_before_the_tiles_were_seen_it_knows_nothing_and_while_they_are_hidden_it_goes_on() -> None:
    topo_map, _ = taught()
    localizer = ThesisLocalizer(topo_map, CAMERA)
    unknown = localizer.update(NOTHING, Pose2D())
    assert (unknown.confidence, unknown.node) == (0.0, -1)
    pose = truth(20.0)
    localizer.update(Frame(0.0, room_with_tiles().render(pose.x, pose.y, pose.yaw, 0.0)), Pose2D())
    hidden = localizer.update(NOTHING, Pose2D(yaw=0.25))
    assert hidden.confidence == 1.0
    assert abs(wrap(hidden.map_from_base.yaw - pose.yaw - 0.25)) < math.radians(1.0)
    localizer.reset()
    assert localizer.update(NOTHING, Pose2D()).node == -1


def test_the_winners_bucket_alone_is_searched() -> None:
    """A sub-node of another unit is never chosen, however alike: that is the thesis' saving, and its error."""
    topo_map, _ = taught()
    localizer = ThesisLocalizer(topo_map, CAMERA)
    pose = truth(33.3)
    frame = Frame(0.0, room_with_tiles().render(pose.x, pose.y, pose.yaw, 0.0))
    place = localizer.update(frame, Pose2D())
    perception = Perceiver(CAMERA).perceive(frame, Pose2D())
    assert perception is not None
    winner = Classifier(topo_map.codebook)(perception.vector).argmin()
    siblings = np.flatnonzero(topo_map.units == winner)
    assert place.node in siblings or not len(siblings)


def test_what_no_map_can_be_made_of_is_refused_with_a_reason() -> None:
    room = room_with_tiles()
    here = Frame(0.0, cv2.resize(room.render(0.2, 0.1, 0.3, 0.0), (640, 480)))
    with pytest.raises(TrainingError, match="0 perceptions"):
        train_thesis("none", [], CAMERA, progress=quiet)
    with pytest.raises(TrainingError, match="both tiles"):
        train_thesis("dark", blank(10), CAMERA, progress=quiet)
    with pytest.raises(TrainingError, match="20 perceptions"):
        train_thesis("short", (sample(k / 2, here) for k in range(20)), CAMERA, progress=quiet)
    still = (TeachingSample(k / 2, Pose2D(), here) for k in range(101))
    with pytest.raises(TrainingError, match=r"hardly moved: 0\.0 m"):
        train_thesis("still", still, CAMERA, progress=quiet)
