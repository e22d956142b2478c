"""Which cameras see the same as the one a map was taught with."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.mapping.calibration import calibration_differs, calibration_of
from omnibotd.core.mapping.topo_map import Edges, TopoMap
from tests.teaching import CAMERA

NONE = np.zeros(0, np.int32)


def taught_with(camera: dict[str, float]) -> TopoMap:
    return TopoMap(
        name="room",
        codebook=np.zeros((4, 2), np.float32),
        units=np.zeros(1, np.uint16),
        snapshots=np.zeros((1, 8), np.uint8),
        poses=np.zeros((1, 3), np.float32),
        sessions=np.zeros(1, np.uint16),
        edges=Edges(NONE, NONE, NONE.astype(np.uint8)),
        camera=camera,
    )


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"cx": CAMERA.cx + 2.0, "cy": CAMERA.cy - 2.0},  # found anew in other frames
        {"tilt": (0.02, -0.02)},  # 1 degree, from a spin calibration
        {"mount_yaw": 1.0},  # undone in every view
        {"fov": math.radians(170.0)},  # a view looks out to 79 degrees
    ],
)
def test_small_changes_are_the_same_camera(change: dict[str, object]) -> None:
    assert calibration_differs(taught_with(calibration_of(CAMERA)), replace(CAMERA, **change)) is None


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("fx", {"fx": 1.1 * CAMERA.fx}),
        ("cx", {"cx": CAMERA.cx + 10.0}),  # 4 degrees at 145 px a radian
        ("cy", {"cy": CAMERA.cy - 10.0}),
        ("k2", {"distortion": (0.0, 0.1, 0.0, 0.0)}),
        ("fov", {"fov": math.radians(120.0)}),
        ("tilt_y", {"tilt": (0.0, 0.1)}),
        ("height", {"height": 360}),
    ],
)
def test_the_number_that_differs_is_named(name: str, change: dict[str, object]) -> None:
    differs = calibration_differs(taught_with(calibration_of(CAMERA)), replace(CAMERA, **change))
    assert differs is not None
    assert f": {name} was " in differs
    assert "room" in differs


def test_the_same_picture_at_half_the_size_is_the_same_camera() -> None:
    assert calibration_differs(taught_with(calibration_of(CAMERA)), CAMERA.reduced(2)) is None


def test_a_map_that_does_not_tell_its_camera_is_believed() -> None:
    assert calibration_differs(taught_with({}), CAMERA) is None
