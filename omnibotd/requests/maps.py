"""Maps and the places in them: `map` and `place`."""

from __future__ import annotations

import base64
import math
from typing import Any

from omnibotd.control import Feedback
from omnibotd.core.mapping.topo_map import EdgeKind, TopoMap
from omnibotd.io.control_server import Session
from omnibotd.io.map_store import MapStore
from omnibotd.map_plot import plot_png
from omnibotd.requests.params import Params, pose_values
from omnibotd.requests.robot import Method, Robot


class Maps:
    """Lists, shows, chooses and edits maps; every edit is on disk before it holds."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def methods(self) -> dict[str, Method]:
        return {
            "map.list": self._map_list,
            "map.use": self._map_use,
            "map.info": self._map_info,
            "map.plot": self._map_plot,
            "map.verify": self._map_verify,
            "place.add": self._place_add,
            "place.list": self._place_list,
            "place.delete": self._place_delete,
        }

    async def _map_list(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        active = self._robot.perception.topo_map.name if self._robot.perception.topo_map else None
        return {"maps": await self._robot.off_loop(self._inventory, active)}

    def _inventory(self, active: str | None) -> list[dict[str, Any]]:
        return [
            {
                "name": entry.name,
                "trained": entry.bytes > 0,
                "nodes": entry.nodes,
                "bytes": entry.bytes,
                "active": entry.name == active,
                "recording_bytes": entry.recording_bytes,
            }
            for entry in self._robot.store.list()
        ]

    async def _map_use(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("map")
        params.end()
        self._robot.refuse_if_busy()
        topo_map = await self._robot.off_loop(self._robot.store.load, name)
        await self._robot.use(topo_map)
        return {"map": name, "nodes": len(topo_map)}

    async def _map_info(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        topo_map = await self._named_map(params)
        return {
            **summary(self._robot.store, topo_map),
            "places": {name: pose_values(pose) for name, pose in topo_map.places.items()},
            "docks": {name: pose_values(dock.map_from_dock) for name, dock in topo_map.docks.items()},
            "ceiling_height": topo_map.ceiling_height if math.isfinite(topo_map.ceiling_height) else None,
            "statistics": {key: value for key, value in topo_map.statistics.items() if math.isfinite(value)},
        }

    async def _map_plot(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        topo_map = await self._named_map(params)
        active = self._robot.perception.topo_map is not None and topo_map.name == self._robot.perception.topo_map.name
        robot = self._robot.control.map_from_base if active else None
        png = await self._robot.off_loop(plot_png, topo_map, robot)
        return {"map": topo_map.name, "png": base64.b64encode(png).decode()}

    async def _map_verify(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("map") if "map" in params else self._robot.active_map().name
        params.end()
        report = await self._robot.off_loop(self._robot.store.verify, name)
        sections = [{"name": s.name, "bytes": s.bytes, "ok": s.ok} for s in report.sections]
        return {"map": name, "ok": report.ok, "sections": sections, "message": report.message}

    async def _named_map(self, params: Params) -> TopoMap:
        name = params.name("map") if "map" in params else None
        params.end()
        active = self._robot.perception.topo_map
        if name is None or (active is not None and active.name == name):
            return self._robot.active_map()
        topo_map: TopoMap = await self._robot.off_loop(self._robot.store.load, name)
        return topo_map

    async def _place_add(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name, pose = params.name("name"), params.pose("at")
        params.end()
        topo_map = self._robot.active_map()
        pose = pose or self._robot.sure_pose(f"place {name!r}")
        await self._robot.edit(topo_map.with_place(name, pose))
        return {"name": name, "pose": pose_values(pose)}

    async def _place_list(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        topo_map = self._robot.active_map()
        places = {name: pose_values(pose) for name, pose in topo_map.places.items()}
        return {
            "places": places,
            "docks": {name: pose_values(dock.map_from_dock) for name, dock in topo_map.docks.items()},
        }

    async def _place_delete(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("name")
        params.end()
        await self._robot.edit(self._robot.active_map().without_place(name))
        return {}


def summary(store: MapStore, topo_map: TopoMap) -> dict[str, Any]:
    size = next((entry.bytes for entry in store.list() if entry.name == topo_map.name), 0)
    counts = {kind.name.lower(): int((topo_map.edges.kind == kind).sum()) for kind in EdgeKind}
    return {
        "map": topo_map.name,
        "nodes": len(topo_map),
        "links": counts,
        "units": len(topo_map.codebook),
        "bytes": size,
        "kb_per_1000_nodes": round(size / 1024 / max(1, len(topo_map)) * 1000, 1),
        "quantization_error": topo_map.statistics.get("quantization_error"),
        "topographic_error": topo_map.statistics.get("topographic_error"),
    }
