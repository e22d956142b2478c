"""What a dock looks like in other lights is kept while the robot rests in it, so that nobody has to come at night.

A view of the light that is there tells to a millimetre where in the dock the robot stands. It stands there still when
the light has changed: then a new view's pose is known, too, however little the two have in common.
"""

from __future__ import annotations

import asyncio
import logging
import math
from dataclasses import dataclass, replace

from omnibotd.control_protocol import RpcError
from omnibotd.core.docking.sightings import agree
from omnibotd.core.errors import CoreError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock, DockView, TopoMap
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.frame import Frame
from omnibotd.io.map_store import MapStoreError
from omnibotd.requests.dock_views import SAME_DOCK, SAME_DOCK_YAW, VIEW_QUALITY
from omnibotd.requests.docking import UNMOVED, UNMOVED_YAW, Docking
from omnibotd.requests.robot import Robot

log = logging.getLogger(__name__)

PERIOD = 60.0  # s between looks
# Correlation from which a view knows where the robot stands (in its own light, even of one pushed askew by millimetres
# and a degree), and below which it may have been carried off unnoticed.
KNOWN, CARRIED = 0.8, 0.25
# A light less like the views than this is worth a view, by how many there are: the fewer places are left (of
# lights.MAX_VIEWS), the more it must tell.
NEW_LIGHT = {1: 0.85, 2: 0.8, 3: 0.7}
# By so much a frame must be more like the last look than like any view: then this light has come to stay, and a view of
# it would tell more.
LIKER = 0.1
# An estimate in another light errs by less than this (m, rad) where the robot still stands.
NEAR, NEAR_YAW = 0.06, math.radians(3.0)


@dataclass(frozen=True, slots=True)
class _Stay:
    """Where in a dock the robot has been standing since `seen` (s), by the best look (its correlation is `score`), and
    what it saw at the last look, if that was in a light without a view."""

    dock: str
    map_from_dock: Pose2D  # another one where the dock was saved afresh
    dock_from_base: Pose2D
    score: float
    odom_from_base: Pose2D
    seen: float
    news: Frame | None = None


class DockWatch:
    """Adds views to the dock that the robot rests in, as long as there is room; it never replaces one."""

    def __init__(self, robot: Robot, docking: Docking) -> None:
        self._robot, self._docking = robot, docking
        self._stay: _Stay | None = None

    async def watch(self) -> None:
        """Look now and then, for ever."""
        while True:
            await asyncio.sleep(PERIOD)
            try:
                await self._look()
            except (CoreError, MapStoreError, RpcError) as error:
                log.warning("the dock's light was not looked at: %s", error)

    async def _look(self) -> None:
        robot, now, name = self._robot, self._robot.now(), self._docking.resting_in()
        # Whatever happens from here on, the robot is known to stand there only if it was seen.
        stay, self._stay = self._still(name), None
        topo_map, frame = robot.perception.topo_map, robot.camera.latest
        if name is None or topo_map is None or frame is None or not robot.camera.ok(now):
            return
        dock, odom = topo_map.docks[name], robot.control.odometry.odom_from_base
        best = await robot.off_loop(self._seen, name, frame, stay)
        if best is None:
            return
        pose, known = best.dock_from_base, best.score >= KNOWN and best.verdict is Verdict.ACCEPTED
        if known and (stay is None or best.score > stay.score):
            if agree(pose, Pose2D(), SAME_DOCK, SAME_DOCK_YAW):
                self._stay = _Stay(name, dock.map_from_dock, pose, best.score, odom, now)
        elif stay is not None and best.score >= CARRIED and agree(pose, stay.dock_from_base, NEAR, NEAR_YAW):
            new = best.score < NEW_LIGHT.get(len(dock.views), 0.0)
            news = await self._news(topo_map, dock, stay, frame, best.score) if new else None
            self._stay = replace(stay, news=news)

    def _still(self, name: str | None) -> _Stay | None:
        """The stay, if it goes on."""
        stay, control = self._stay, self._robot.control
        topo_map = self._robot.perception.topo_map
        dock = None if topo_map is None or name is None else topo_map.docks[name]
        if stay is None or dock is None or stay.dock != name or control.moved_at > stay.seen:
            return None
        if stay.map_from_dock != dock.map_from_dock:
            return None
        return stay if agree(stay.odom_from_base, control.odometry.odom_from_base, UNMOVED, UNMOVED_YAW) else None

    def _seen(self, name: str, frame: Frame, stay: _Stay | None) -> HomingEstimate | None:
        """On the worker: what the view that is most like the frame makes of it."""
        perception = self._robot.perception
        lights = perception.lights_at(name)
        if lights is None:
            return None
        seen = lights.each_of(perception.marked(frame), None if stay is None else stay.dock_from_base)
        return max(seen, key=lambda estimate: estimate.score)

    async def _news(self, topo_map: TopoMap, dock: Dock, stay: _Stay, frame: Frame, score: float) -> Frame | None:
        """Keeps the last look as a view if the frame is more like it than like any view (`score`); else looks anew."""
        robot = self._robot
        if stay.news is None or await robot.off_loop(self._likeness, topo_map, stay.news, frame) < score + LIKER:
            return await robot.still()
        view = DockView(await robot.off_loop(stay.news.jpeg, VIEW_QUALITY), stay.dock_from_base)

        def added(newest: TopoMap) -> TopoMap:
            unchanged = newest.docks.get(stay.dock) is dock
            return newest.with_dock(stay.dock, replace(dock, views=(*dock.views, view))) if unchanged else newest

        if robot.control.moved_at <= stay.seen:
            await robot.edit(added)
            log.info("dock %s: kept a view of it in another light (view %d)", stay.dock, len(dock.views) + 1)
        return None

    def _likeness(self, topo_map: TopoMap, before: Frame, frame: Frame) -> float:
        """On the worker: the correlation of a frame with one from before, as a view."""
        perception = self._robot.perception
        if perception.model is None:
            return 0.0
        lights = perception.lights_of(
            topo_map, Dock(Pose2D(), (DockView(before.jpeg(VIEW_QUALITY)),)), perception.model
        )
        return lights.track(perception.marked(frame), Pose2D(), Pose2D()).score
