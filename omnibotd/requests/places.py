"""Named places of the active map; its docks are places, too."""

from __future__ import annotations

from dataclasses import replace
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
        self._refuse_if_docking(old)
        await self._robot.edit(lambda topo_map: _renamed(topo_map, old, new))
        topo_map = self._robot.active_map()
        pose = topo_map.places[new] if new in topo_map.places else topo_map.docks[new].map_from_dock
        return {"name": new, "pose": pose_values(pose)}

    async def _place_delete(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("name")
        params.end()
        self._refuse_if_docking(name)
        await self._robot.edit(lambda topo_map: _without(topo_map, name))
        return {}

    def _refuse_if_docking(self, name: str) -> None:
        """A job that docks asks for its dock by name, to its end."""
        if name not in self._robot.active_map().places:
            self._robot.refuse_if_busy()


def _without(topo_map: TopoMap, name: str) -> TopoMap:
    """The map without the place, or without the dock where no place has the name."""
    if name in topo_map.places:
        return topo_map.without_place(name)
    if name not in topo_map.docks:
        known = ", ".join(sorted({*topo_map.places, *topo_map.docks})) or "none"
        raise RpcError.named(ErrorName.NO_SUCH_PLACE, f"no place {name!r}; places and docks of this map: {known}")
    return replace(topo_map, docks={key: dock for key, dock in topo_map.docks.items() if key != name})


def _renamed(topo_map: TopoMap, old: str, new: str) -> TopoMap:
    without = _without(topo_map, old)
    if old in topo_map.places:
        if new in topo_map.places:
            raise invalid(f"to: there is a place {new!r} already; delete it first, or choose another name")
        return without.with_place(new, topo_map.places[old])
    if new in topo_map.docks:
        raise invalid(f"to: there is a dock {new!r} already; delete it first, or choose another name")
    return without.with_dock(new, topo_map.docks[old])
