"""Perception on its own: what may happen while a map is made ready."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from omnibotd.config import BaseConfig, CameraConfig, Config
from omnibotd.core.decision import HomingRequest
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock, TopoMap
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.view import RINGS, SECTORS
from omnibotd.perception import Perception
from tests.made_maps import made_map


def perception(loaded: asyncio.Event) -> Perception:
    """With a lens; a map is ready when `loaded` is set."""

    async def off_loop(*_: Any) -> object:
        await loaded.wait()
        return object()

    config = Config(camera=CameraConfig(source="/dev/video0"), base=BaseConfig(driver="omnibot", port="/dev/ttyUSB0"))
    made = Perception(config, SimpleNamespace(forget_pose=lambda: None), None, off_loop)
    made.localizer_of = lambda topo_map, model: off_loop()
    made.model = object()
    return made


def used_while(topo_map: TopoMap, edited: TopoMap) -> TopoMap | None:
    """What is in use when a map was edited while another reading of it was made ready."""

    async def main() -> TopoMap | None:
        loaded = asyncio.Event()
        made = perception(loaded)
        made.topo_map = topo_map
        using = asyncio.create_task(made.use(topo_map))
        await asyncio.sleep(0)
        made.edited(edited)
        loaded.set()
        await using
        return made.topo_map

    return asyncio.run(main())


def test_a_place_named_while_the_map_is_made_ready_is_kept() -> None:
    topo_map = made_map()
    edited = replace(topo_map, places={"desk": Pose2D(1.0, 0.0)})
    assert used_while(topo_map, edited) is edited


def test_docking_is_told_of_the_dirt_that_navigation_found() -> None:
    made, shown = perception(asyncio.Event()), list[Frame]()
    dirty = np.zeros((RINGS, SECTORS), np.bool_)
    made.topo_map = replace(made_map(), docks={"home": Dock(Pose2D(), ())})
    made._localizer = SimpleNamespace(dirty=dirty)
    made._registration = ("home", SimpleNamespace(fix=lambda frame, odom: shown.append(frame)))
    made._home(HomingRequest("home", None), Frame(3.0, b""), Pose2D())
    assert shown[0].stamp == 3.0
    assert shown[0].dirty is dirty


def test_an_edit_of_the_map_before_does_not_stop_a_change_of_maps() -> None:
    topo_map = made_map("attic", seed=2)
    assert used_while(topo_map, made_map()) is topo_map
