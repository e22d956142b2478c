"""Heading and position by the ceiling alone, in rooms; the truth is where the renderer stood."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from omnibotd.core.compass.ceiling_tracker import CeilingTracker, Step, Tracked
from omnibotd.core.errors import FrameError
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.sim import ceilings
from tools.sim.world import World

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))
HEIGHT = 2.2
DARK = Frame(0.0, np.full((480, 640), 20, np.uint8))


@cache
def world(style: str) -> World:
    return getattr(ceilings, style)(21)


def see(style: str, pose: Pose2D) -> Frame:
    return Frame(0.0, world(style).render(pose.x, pose.y, pose.yaw, 0.0))


def arc(count: int, length: float, turn: float) -> list[Pose2D]:
    """Poses from the room's middle along an arc."""
    step = Pose2D(
        length / count * math.cos(turn / count / 2), length / count * math.sin(turn / count / 2), turn / count
    )
    poses = [Pose2D(-0.4, 0.2, 0.5)]
    for _ in range(count):
        poses.append(poses[-1] @ step)
    return poses


def follow(style: str, poses: list[Pose2D], camera: CameraModel = CAMERA) -> list[Tracked]:
    tracker = CeilingTracker(camera, HEIGHT)
    return [tracker.update(see(style, pose)) for pose in poses]


@pytest.mark.parametrize("style", ["tiles", "plain", "beams"])
def test_an_arc_is_followed_by_sight_alone(style: str) -> None:
    poses = arc(24, 0.7, math.radians(60.0))
    found = follow(style, poses)
    true = poses[0].inverse() @ poses[-1]
    assert all(tracked.seen for tracked in found[1:])
    assert abs(wrap(found[-1].pose.yaw - true.yaw)) < 0.006
    assert found[-1].pose.distance(true) < 0.12  # of 0.7 m: how high the ceiling is goes into that


@pytest.mark.parametrize("backwards", [False, True])
def test_in_a_hall_a_lens_centred_wrongly_takes_nothing_from_the_turn(backwards: bool) -> None:
    """Six pixels: with the nearness of all things left free, it takes 2 degrees of 172 from the turn."""
    poses = arc(60, 5.0, 3.0)[:: -1 if backwards else 1]
    found = follow("hall", poses, replace(CAMERA, cx=CAMERA.cx + 6.0))
    assert all(tracked.seen for tracked in found[1:])
    assert abs(wrap(found[-1].pose.yaw - (-3.0 if backwards else 3.0))) < 0.025


def test_where_it_has_been_errors_do_not_add_up() -> None:
    """Out and back three times ends as near as once."""
    out = arc(12, 0.7, 0.4)
    poses = (out + out[::-1]) * 3
    found = follow("plain", poses)
    true = [poses[0].inverse() @ pose for pose in poses]
    errors = [abs(wrap(tracked.pose.yaw - pose.yaw)) for tracked, pose in zip(found, true, strict=True)]
    assert max(errors[-12:]) < max(errors[:24]) + 0.001
    assert found[-1].pose.distance(true[-1]) < 0.01


def test_while_it_sees_nothing_it_goes_by_the_wheels() -> None:
    poses = arc(12, 0.3, 0.3)
    tracker = CeilingTracker(CAMERA, HEIGHT)
    step = Step(poses[0].inverse() @ poses[1], 0.01, 0.02)
    found = []
    for number, pose in enumerate(poses):
        frame = DARK if 4 <= number < 8 else see("tiles", pose)
        found.append(tracker.update(frame, step if number else None))
    assert [tracked.seen for tracked in found[1:]] == [True] * 3 + [False] * 4 + [True] * 5
    assert abs(wrap(found[-1].pose.yaw - 0.3)) < 0.004


def test_the_wheels_say_how_long_a_metre_is() -> None:
    """Told a ceiling a fifth too high, it measures too long by itself, and less so with the wheels."""
    poses = arc(24, 0.7, 0.0)
    steps = [before.inverse() @ now for before, now in pairwise(poses)]
    alone, led = (CeilingTracker(CAMERA, 1.2 * HEIGHT, 0.3) for _ in range(2))
    for number, pose in enumerate(poses):
        frame = see("tiles", pose)
        far = alone.update(frame).pose
        near = led.update(frame, Step(steps[number - 1], 0.0003, 0.01) if number else None).pose
    assert 1.1 < math.hypot(far.x, far.y) / 0.7 < 1.3
    assert math.hypot(near.x, near.y) / 0.7 == pytest.approx(1.0, abs=0.03)


def test_a_frame_of_another_size_is_refused() -> None:
    with pytest.raises(FrameError, match="calibrate at this size"):
        CeilingTracker(CAMERA, HEIGHT).update(Frame(0.0, np.zeros((240, 320), np.uint8)))
