"""The map on which tools/runaway goes to places: taught once, in virtual time, and kept."""

from __future__ import annotations

import shutil
from pathlib import Path

from omnibotd.io.map_format import VERSION
from tools.sim import virtual_time
from tools.sim.ceilings import tiles
from tools.sim.teacher import Area, Teacher, teach
from tools.sim.virtual_robot import virtual_robot

SEED = 5
FLOOR = 2.4  # m, the side of the square round the middle in which the robot is put down and sent about
_TAUGHT, _SECONDS = 3.0, 100.0  # m, the side of the square that is taught; s, of driving
_KEPT = Path(f"out/runaway/home-{VERSION}.omap")  # one of an earlier format would be refused


def taught_map() -> Path:
    """The map file; takes a quarter of a minute the first time."""
    if not _KEPT.exists():
        _KEPT.parent.mkdir(parents=True, exist_ok=True)
        virtual_time.run(_teach())
    return _KEPT


async def _teach() -> None:
    world = tiles(SEED)
    async with virtual_robot(world, SEED) as robot:
        await teach(robot, Teacher(robot, Area.to_teach(world, side=_TAUGHT), SEED), "home", _SECONDS)
        shutil.copy(robot.store.directory / "home.omap", _KEPT.with_suffix(".part"))
    _KEPT.with_suffix(".part").replace(_KEPT)
