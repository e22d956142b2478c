"""Maps: list, choose, show, check, prune and delete them."""

from __future__ import annotations

import asyncio
import base64
import math
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.planning import Route, roads_of
from omnibotd.io.control_server import Session
from omnibotd.io.map_store import MapStore
from omnibotd.map_plot import ROUTE, TRAIL, Path, plot_png, plot_svg
from omnibotd.requests.params import Params, invalid, pose_values
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.summary import summary
from omnibotd.requests.teaching import Teaching
from omnibotd.requests.trail import Trail

Pruner = Callable[[str, int, MapStore], Awaitable[TopoMap]]  # (name, nodes, store)
FORMATS = ("png", "svg")
MAX_NODES = 10_000_000  # more than any file may hold
ROUTE_CORNERS = 200  # straight pieces of a route drawn; a way through a building has dozens


@dataclass(frozen=True, slots=True)
class Scene:
    """What a plot of the active map shows besides it."""

    robot: Pose2D | None
    strokes: list[list[tuple[float, float]]]
    goals: tuple[Pose2D, ...]


class Maps:
    """Every change is on disk before it holds."""

    def __init__(self, robot: Robot, teaching: Teaching, trail: Trail, pruner: Pruner) -> None:
        self._robot, self._teaching, self._trail, self._pruner = robot, teaching, trail, pruner

    def methods(self) -> dict[str, Method]:
        return {
            "map.list": self._map_list,
            "map.use": self._map_use,
            "map.info": self._map_info,
            "map.plot": self._map_plot,
            "map.verify": self._map_verify,
            "map.prune": self._map_prune,
            "map.delete": self._map_delete,
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
            **await asyncio.to_thread(summary, self._robot.store, topo_map),
            "method": topo_map.method,
            "sessions": _sessions(topo_map),
            "recordings": await asyncio.to_thread(self._recordings, topo_map),
            "places": {name: pose_values(pose) for name, pose in topo_map.places.items()},
            "docks": {name: pose_values(dock.map_from_dock) for name, dock in topo_map.docks.items()},
            "ceiling_height": topo_map.ceiling_height if math.isfinite(topo_map.ceiling_height) else None,
            "statistics": {key: value for key, value in topo_map.statistics.items() if math.isfinite(value)},
        }

    def _recordings(self, topo_map: TopoMap) -> list[dict[str, Any]]:
        """The recordings on disk under the map's name, and whether the map was made from them."""
        return [
            {"file": path.name, "bytes": path.stat().st_size, "trained": path.name in topo_map.recordings}
            for path in self._robot.store.recordings(topo_map.name)
        ]

    async def _map_plot(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        kind = params.text("format", 8) if "format" in params else "png"
        if kind not in FORMATS:
            raise invalid(f"format: {kind!r} given, expected {' or '.join(FORMATS)}")
        topo_map = await self._named_map(params)
        scene = self._scene() if self._robot.is_active(topo_map.name) else Scene(None, [], ())
        picture = await asyncio.to_thread(_drawn, topo_map, scene, kind)
        return {"map": topo_map.name, kind: base64.b64encode(picture).decode()}

    def _scene(self) -> Scene:
        running = self._robot.control.running
        goals = self._robot.goals[(running.last.waypoint or 1) - 1 :] if running is not None else ()
        return Scene(self._robot.control.map_from_base, self._trail.strokes(), goals)

    async def _map_verify(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = self._name_or_active(params)
        params.end()
        report = await asyncio.to_thread(self._robot.store.verify, name)
        sections = [{"name": s.name, "bytes": s.bytes, "ok": s.ok} for s in report.sections]
        return {"map": name, "ok": report.ok, "sections": sections, "message": report.message}

    async def _map_prune(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name, limit = self._name_or_active(params), params.whole("nodes", None, 1, MAX_NODES)
        params.end()
        self._refuse_if_in_use(name)
        async with self._robot.editing:
            count = len(await asyncio.to_thread(self._robot.store.load, name))
            if count <= limit:
                raise invalid(f"nodes: map {name!r} has {count} nodes, which is not more than {limit}")
            feedback({"stage": "pruning"})
            pruned = await self._pruner(name, limit, self._robot.store)
            warnings = await self._take_into_use(pruned)
        made = await asyncio.to_thread(summary, self._robot.store, pruned)
        kept = f"{self._robot.store.file(name)}~"
        return {**made, "nodes_before": count, "kept": kept, "warnings": warnings}

    async def _take_into_use(self, pruned: TopoMap) -> list[str]:
        """Where it is the active map; a job that began meanwhile goes on with the map it has."""
        if not self._robot.is_active(pruned.name):
            return []
        if self._robot.control.running is not None:
            return [f"not in use yet, a job is running: say map use {pruned.name} when it has ended"]
        await self._robot.use(pruned)
        return []

    async def _map_delete(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("map")
        params.end()
        self._refuse_if_in_use(name)
        async with self._robot.editing:
            kept = await asyncio.to_thread(self._robot.store.delete, name)
            if self._robot.is_active(name):
                await self._robot.perception.use(None)
        return {"map": name, "kept": str(kept)}

    def _refuse_if_in_use(self, name: str) -> None:
        """A job needs the active map as it is, and a training is about to write its own."""
        if self._robot.is_active(name):
            self._robot.refuse_if_busy()
        if self._teaching.training == name:
            raise RpcError.named(ErrorName.BUSY, f"map {name!r} is being trained; say stop, or wait for its end")

    def _name_or_active(self, params: Params) -> str:
        return params.name("map") if "map" in params else self._robot.active_map().name

    async def _named_map(self, params: Params) -> TopoMap:
        name = self._name_or_active(params)
        params.end()
        if self._robot.is_active(name):
            return self._robot.active_map()
        topo_map: TopoMap = await asyncio.to_thread(self._robot.store.load, name)
        return topo_map


def _sessions(topo_map: TopoMap) -> list[dict[str, Any]]:
    """Each teaching drive with the recording it came from, where that is known, and its share of the nodes."""
    counts = Counter(topo_map.sessions.tolist())
    recordings = dict(enumerate(topo_map.recordings))
    return [
        {"session": number, "recording": recordings.get(number), "nodes": counts[number]}
        for number in sorted(counts.keys() | recordings.keys())
    ]


def _drawn(topo_map: TopoMap, scene: Scene, kind: str) -> bytes:
    paths = [
        Path(points, TRAIL, "last trajectory" if number == 0 else "") for number, points in enumerate(scene.strokes)
    ]
    way = _way(topo_map, scene)
    if len(way) > 1:
        paths.append(Path(way, ROUTE, "route"))
    return (plot_png if kind == "png" else plot_svg)(topo_map, scene.robot, paths)


def _way(topo_map: TopoMap, scene: Scene) -> list[tuple[float, float]]:
    """Corners of the way from the robot through its goals, as a navigator would drive it; as far as one leads there."""
    if scene.robot is None:
        return []
    here, way = scene.robot, [(scene.robot.x, scene.robot.y)]
    roads = roads_of(topo_map)
    for goal in scene.goals:
        route = Route(roads, goal, roads.floor.copy())
        route.advance()
        for _ in range(ROUTE_CORNERS):
            corner = route.carrot(here)
            if corner is None:
                return way
            here = corner
            way.append((here.x, here.y))
            if here.distance(goal) < 1e-6:
                break
    return way
