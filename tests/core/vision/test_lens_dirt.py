"""Dirt on the lens: found while the robot turns, whatever it drives under, and not found where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.descriptor import Descriptor
from omnibotd.core.vision.lens_dirt import LensDirt
from omnibotd.core.vision.view import RINGS, SECTORS, View
from tests.teaching import frame
from tools.sim import ceilings
from tools.sim.conditions import Stage, lens_of

SEEN = np.ones((RINGS, SECTORS), np.bool_)
SMUDGE = np.zeros((RINGS, SECTORS), np.bool_)
SMUDGE[5:9, 10:14] = True


def world(seed: int = 0) -> View:
    """A texture as relative gradients are, of heading 0."""
    return np.random.default_rng(seed).gamma(2.0, 0.3, (RINGS, SECTORS)).astype(np.float32)


def turned(view: View, yaw: float, value: float | None = None) -> View:
    """What a robot at that heading sees of it, through a smudge that looks like `value` everywhere."""
    seen = np.roll(view, -round(yaw / math.tau * SECTORS), 1)
    return seen if value is None else np.where(SMUDGE, np.float32(value), seen).astype(np.float32)


def after_a_turn(value: float | None, share: float = 1.0) -> LensDirt:
    dirt = LensDirt(SEEN)
    for yaw in np.arange(0.0, share * math.tau, 0.15):
        dirt.without(turned(world(), float(yaw), value), Pose2D(yaw=float(yaw)))
    return dirt


@pytest.mark.parametrize("value", [0.0, 1.5])
def test_one_turn_finds_a_smudge_dull_or_edged(value: float) -> None:
    dirt = after_a_turn(value)
    assert dirt.dirty[SMUDGE].mean() > 0.9
    assert dirt.dirty[~SMUDGE].mean() < 0.02


def test_a_clean_lens_is_clean() -> None:
    assert after_a_turn(None).dirty.mean() < 0.01


def test_half_a_turn_proves_nothing() -> None:
    assert not after_a_turn(1.5, 0.5).dirty.any()


def test_dirty_cells_become_their_ring_s_mean_and_others_stay() -> None:
    dirt = after_a_turn(1.5)
    texture = turned(world(3), 1.0, 1.5)
    clean = dirt.without(texture, Pose2D(1.0))
    assert (clean[~dirt.dirty] == texture[~dirt.dirty]).all()
    ring = clean[6]
    assert np.ptp(ring[dirt.dirty[6]]) == 0.0
    assert ring[10] == pytest.approx(texture[6][~dirt.dirty[6]].mean(), rel=1e-5)


def test_a_robot_that_stands_learns_nothing() -> None:
    dirt = LensDirt(SEEN)
    for _ in range(200):
        dirt.without(turned(world(), 0.0, 1.5), Pose2D(0.01, 0.0, 0.02))
    assert not dirt.dirty.any()


def test_a_lens_that_was_wiped_is_clean_after_some_turns() -> None:
    dirt = after_a_turn(1.5)
    for yaw in np.arange(0.0, 4.0 * math.tau, 0.15):
        dirt.without(turned(world(1), float(yaw)), Pose2D(yaw=float(yaw)))
    assert dirt.dirty.mean() < 0.02


def test_of_what_a_smudged_lens_costs_in_the_dark_a_third_comes_back() -> None:
    """From the second turn on; the rest is what the smudge hides. Likeness to the view by day, through a clean lens."""
    room = ceilings.tiles(6)
    stage = Stage(room, lambda light: ceilings.tiles(6, light), 6)
    descriptor = Descriptor(lens_of(room))
    dirt, likeness = LensDirt(descriptor.seen), np.empty((0, 3))
    for yaw in np.arange(0.0, 2.0 * math.tau, 0.2):
        pose = Pose2D(0.3, -0.2, float(yaw))
        day = descriptor.view(frame(room, pose, 0.0))
        stage.enter(("night",))
        dark = descriptor.texture(frame(stage, pose, 0.0))
        stage.enter(("night", "occluded"), 2)
        smudged = descriptor.texture(frame(stage, pose, 0.0))
        wiped = dirt.without(smudged, pose)
        likeness = np.vstack([likeness, [(day * descriptor.normalised(x)).mean() for x in (smudged, wiped, dark)]])
    smudged_like, wiped_like, dark_like = likeness[len(likeness) // 2 :].mean(0)
    assert dark_like > smudged_like
    assert wiped_like - smudged_like > (dark_like - smudged_like) / 3.0
