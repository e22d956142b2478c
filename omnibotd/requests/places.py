"""Named places of the active map."""

from __future__ import annotations

from typing import Any

from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.io.control_server import Session
from omnibotd.requests.params import Params, invalid, pose_values
from omnibotd.requests.robot import Method, Robot


class Places:
    """Every edit is on disk before it holds."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def methods(self) -> dict[str, Method]:
        return {
            "place.add": self._place_add,
            "place.list": self._place_list,
            "place.rename": self._place_rename,
            "place.delete": self._place_delete,
        }

    async def _place_add(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name, at = params.name("name"), params.pose("at")
        params.end()
        self._robot.active_map()
        pose = at or self._robot.sure_pose(f"place {name!r}")
        await self._robot.edit(lambda topo_map: topo_map.with_place(name, pose))
        return {"name": name, "pose": pose_values(pose)}

    async def _place_list(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        topo_map = self._robot.active_map()
        return {
            "map": topo_map.name,
            "places": {name: pose_values(pose) for name, pose in topo_map.places.items()},
            "docks": {name: pose_values(dock.map_from_dock) for name, dock in topo_map.docks.items()},
        }

    async def _place_rename(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        old, new = params.name("name"), params.name("to")
        params.end()
        await self._robot.edit(lambda topo_map: _renamed(topo_map, old, new))
        return {"name": new, "pose": pose_values(self._robot.active_map().places[new])}

    async def _place_delete(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("name")
        params.end()
        await self._robot.edit(lambda topo_map: _known(topo_map, name).without_place(name))
        return {}


def _known(topo_map: TopoMap, name: str) -> TopoMap:
    if name not in topo_map.places:
        known = ", ".join(sorted(topo_map.places)) or "none"
        raise RpcError.named(ErrorName.NO_SUCH_PLACE, f"no place {name!r}; places of this map: {known}")
    return topo_map


def _renamed(topo_map: TopoMap, old: str, new: str) -> TopoMap:
    pose = _known(topo_map, old).places[old]
    if new in topo_map.places:
        raise invalid(f"to: there is a place {new!r} already; delete it first, or choose another name")
    return topo_map.without_place(old).with_place(new, pose)
