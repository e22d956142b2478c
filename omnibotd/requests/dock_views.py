"""`dock save`: where the robot stands is a dock, or the same dock in another light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.docking.lights import with_view
from omnibotd.core.docking.sightings import agree
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock, DockView
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.frame import Frame
from omnibotd.io.control_server import Session
from omnibotd.requests.docking import IN_DOCK, Docking
from omnibotd.requests.params import Params, pose_values
from omnibotd.requests.robot import Method, Robot

SAME_DOCK, SAME_DOCK_YAW = 0.05, math.radians(5.0)  # m, rad; farther off, the dock was moved
VIEW_QUALITY = 95  # of a view's JPEG: in the dark edges are a few grey levels
ON_TRUST = "the dock was not recognised in this light: the new view counts as taken where the contact holds the robot"


@dataclass(frozen=True, slots=True)
class _Standing:
    """Where in a dock that is known the robot stands, and how like each of its views the new one is."""

    dock_from_base: Pose2D
    likeness: list[float]
    warnings: list[str]


class DockViews:
    """Saves docks and their views."""

    def __init__(self, robot: Robot, docking: Docking) -> None:
        self._robot, self._docking = robot, docking

    def methods(self) -> dict[str, Method]:
        return {"dock.save": self._dock_save}

    async def _dock_save(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name, fresh = params.name("name"), params.flag("fresh")
        params.end()
        known = self._robot.active_map().docks.get(name)
        self._robot.refuse_if_busy()
        frame = await self._robot.still()
        jpeg = await self._robot.off_loop(frame.jpeg, VIEW_QUALITY)
        standing = await self._standing(name, known, frame) if known is not None and not fresh else None
        if standing is None or known is None:
            dock = Dock(self._robot.sure_pose(f"dock {name!r}"), (DockView(jpeg),))
        else:
            view = DockView(jpeg, standing.dock_from_base)
            dock = Dock(known.map_from_dock, with_view(known.views, view, standing.likeness))
        await self._robot.edit(lambda topo_map: topo_map.with_dock(name, dock))
        return {
            "name": name,
            "pose": pose_values(dock.map_from_dock),
            "views": len(dock.views),
            "added": standing is not None,
            "offset": pose_values(standing.dock_from_base) if standing is not None else None,
            "warnings": standing.warnings if standing is not None else [],
        }

    async def _standing(self, name: str, dock: Dock, frame: Frame) -> _Standing | None:
        """None where the robot is not known to stand in the dock as it was saved: then this is another dock."""
        seen = await self._robot.off_loop(self._compare, dock, frame)
        likeness = [estimate.score for estimate in seen]
        sure = [estimate for estimate in seen if estimate.verdict is Verdict.ACCEPTED]
        if sure:
            pose = max(sure, key=lambda estimate: estimate.score).dock_from_base
            return _Standing(pose, likeness, []) if agree(pose, Pose2D(), SAME_DOCK, SAME_DOCK_YAW) else None
        docked = self._docking.docked_at(name)
        if docked is not None:
            return _Standing(docked, likeness, [])
        return _Standing(Pose2D(), likeness, [ON_TRUST]) if self._held_by(dock) else None

    def _compare(self, dock: Dock, frame: Frame) -> list[HomingEstimate]:
        """On the worker."""
        perception = self._robot.perception
        if perception.model is None:
            raise RpcError.named(ErrorName.CAMERA_DOWN, "the lens is not known before pictures come; try again")
        return perception.lights_of(self._robot.active_map(), dock, perception.model).each_of(frame)

    def _held_by(self, dock: Dock) -> bool:
        """Whether the contact is closed, and the map knows of no other place."""
        here, latest = self._robot.known_pose(), self._robot.base.latest
        charging = latest is not None and bool(latest.charging)
        return charging and (here is None or here.distance(dock.map_from_dock) < IN_DOCK)
