"""Calibrations of the whole daemon with a simulated robot: measured, kept, and in use after the next start."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from omnibotd.core.geometry import Pose2D
from tools.sim import ceilings, virtual_time
from tools.sim.virtual_robot import virtual_robot

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
WORLD = ceilings.tiles(5)
START = Pose2D(0.0, 0.0, 0.0)


def session(directory: Path, *verbs: str) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The replies to these verbs of a robot whose wheels are 3 % larger than configured, and its status before them."""

    async def main() -> tuple[list[dict[str, Any]], dict[str, Any]]:
        async with virtual_robot(WORLD, 5, START, wheel_error=0.03, directory=directory) as robot:
            status = await robot.call("status")
            return [await robot.call(verb) for verb in verbs], status

    return virtual_time.run(main())


def test_a_spin_finds_the_axis_and_the_next_start_uses_it(tmp_path: Path) -> None:
    (spin,), before = session(tmp_path, "calibrate.spin")
    assert before["calibrations"] == []
    assert spin["centre"] == pytest.approx([319.5, 239.5], abs=0.6)
    assert math.degrees(math.hypot(*spin["tilt"])) < 0.2
    _, after = session(tmp_path)
    (told,) = after["calibrations"]
    assert (told["name"], told["in_use"]) == ("spin", True)


def test_the_wheels_are_measured(tmp_path: Path) -> None:
    (base,), _ = session(tmp_path, "calibrate.base")
    # Without a ceiling height or a tape only the shape is known: separation over radius, 3 % from the configured one.
    true = 0.23 / 0.035
    assert base["scale"] == "nominal"
    assert base["wheel_separation"] / base["wheel_radius"] == pytest.approx(true, rel=0.01)
