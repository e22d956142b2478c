"""Docking's registration as a compass."""

from __future__ import annotations

import math

import numpy as np
import pytest

from omnibotd.core.compass.registered import Registered
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.sim import ceilings

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))
WORLD = ceilings.beams(23)
COVERED = Frame(0.0, np.full((480, 640, 3), 40, np.uint8))


def seen(number: int) -> Frame:
    """On an arc: 4 cm and 0.05 rad a frame."""
    yaw = 0.05 * number
    return Frame(0.0, WORLD.render(-0.6 + 0.8 * math.sin(yaw), -0.9 - 0.8 * math.cos(yaw), yaw, 0.1 * number))


def test_a_metre_and_a_turn_over_several_key_views() -> None:
    compass = Registered(CAMERA)
    turns = [compass.turn(seen(number)) for number in range(26)]
    assert (turns[0].ok, turns[0].angle) == (False, 0.0)
    assert all(turn.ok for turn in turns[1:])
    assert sum(turn.angle for turn in turns) == pytest.approx(1.25, abs=0.006)


def test_a_covered_lens_says_nothing_and_is_got_over() -> None:
    compass = Registered(CAMERA)
    for number in range(6):
        compass.turn(seen(number))
    assert not any(compass.turn(COVERED).ok for _ in range(5))
    for number in range(6, 10):  # what covered it was taken for a view, and must be found out first
        compass.turn(seen(number))
    turns = [compass.turn(seen(number)) for number in range(10, 16)]
    assert all(turn.ok for turn in turns)
    assert sum(turn.angle for turn in turns) == pytest.approx(0.3, abs=0.004)
