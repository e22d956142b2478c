"""A picture of a map that a stranger understands: floor, nodes, links, places, docks, the robot, paths, a scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import EdgeKind, TopoMap
from omnibotd.map_canvas import LEGEND, MARGIN, Canvas, Colour, PixelCanvas, Point, SvgCanvas

FLOOR: Colour = (240, 244, 236)
LINKS = {
    EdgeKind.PROXIMITY: (222, 222, 214),
    EdgeKind.SIMILARITY: (214, 190, 150),
    EdgeKind.ODOMETRY: (190, 160, 110),
}
NODE: Colour = (150, 105, 60)
PLACE: Colour = (40, 40, 200)
DOCK: Colour = (150, 60, 150)
ROBOT: Colour = (60, 150, 40)
TRAIL: Colour = (0, 130, 240)
ROUTE: Colour = (200, 60, 220)
INK: Colour = (60, 60, 60)
GRID: Colour = (228, 228, 228)

FLOOR_RADIUS = 0.3  # m, as far as the robot takes the floor to be free beside where it was driven


@dataclass(frozen=True, slots=True)
class Path:
    """A line to draw over the map: positions in the map, and what the legend says ("": nothing)."""

    points: Sequence[Point]
    colour: Colour
    label: str


def plot_png(topo_map: TopoMap, robot: Pose2D | None = None, paths: Sequence[Path] = ()) -> bytes:
    """The map as PNG bytes, with the robot's pose and paths where given."""
    canvas = PixelCanvas(*_extent(topo_map, paths))
    _draw(canvas, topo_map, robot, paths)
    return canvas.png()


def plot_svg(topo_map: TopoMap, robot: Pose2D | None = None, paths: Sequence[Path] = ()) -> bytes:
    """The same as an SVG file in UTF-8."""
    canvas = SvgCanvas(*_extent(topo_map, paths))
    _draw(canvas, topo_map, robot, paths)
    return canvas.svg()


def _extent(topo_map: TopoMap, paths: Sequence[Path]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest corner (m) of what is drawn, with room around."""
    drawn = [np.asarray(topo_map.poses[:, :2], np.float64)]
    points = np.concatenate([*drawn, *(np.array(path.points, np.float64).reshape(-1, 2) for path in paths)])
    return points.min(axis=0) - 2 * FLOOR_RADIUS, points.max(axis=0) + 2 * FLOOR_RADIUS


def _draw(canvas: Canvas, topo_map: TopoMap, robot: Pose2D | None, paths: Sequence[Path]) -> None:
    nodes: list[Point] = [(x, y) for x, y, _ in topo_map.poses.tolist()]
    low, high = _extent(topo_map, paths)
    canvas.dots(nodes, round(FLOOR_RADIUS * canvas.scale), FLOOR)
    _grid(canvas, low + 2 * FLOOR_RADIUS, high - 2 * FLOOR_RADIUS)
    for kind, colour in LINKS.items():
        chosen = topo_map.edges.kind == kind
        ends = zip(topo_map.edges.first[chosen].tolist(), topo_map.edges.second[chosen].tolist(), strict=True)
        canvas.lines([[nodes[first], nodes[second]] for first, second in ends], colour)
    canvas.dots(nodes, 2, NODE)
    for path in paths:
        canvas.lines([path.points], path.colour, 2)
    _marks(canvas, topo_map, robot)
    _legend(canvas, topo_map, robot, paths)


def _grid(canvas: Canvas, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Lines every metre with their coordinates."""
    left, bottom, right, top = (
        *(float(value) - FLOOR_RADIUS for value in low),
        *(float(value) + FLOOR_RADIUS for value in high),
    )
    for x in range(math.ceil(left), math.floor(right) + 1):
        canvas.lines([[(x, bottom), (x, top)]], GRID)
        px, py = canvas.at(x, bottom)
        canvas.text(px - 12, py + 22, f"{x} m", INK, 0.4)
    for y in range(math.ceil(bottom), math.floor(top) + 1):
        canvas.lines([[(left, y), (right, y)]], GRID)
        px, py = canvas.at(left, y)
        canvas.text(px - 38, py + 4, f"{y} m", INK, 0.4)


def _marks(canvas: Canvas, topo_map: TopoMap, robot: Pose2D | None) -> None:
    poses = [(name, pose, PLACE) for name, pose in topo_map.places.items()]
    poses += [(name, dock.map_from_dock, DOCK) for name, dock in topo_map.docks.items()]
    for name, pose, colour in poses:
        canvas.dots([(pose.x, pose.y)], 7, colour)
        canvas.arrow(pose, 0.3, colour)
        px, py = canvas.at(pose.x, pose.y)
        canvas.text(px + 10, py - 10, name, colour, 0.6)
    if robot is not None:
        canvas.ring(robot.x, robot.y, round(0.17 * canvas.scale), ROBOT)
        canvas.arrow(robot, 0.25, ROBOT)


def _legend(canvas: Canvas, topo_map: TopoMap, robot: Pose2D | None, paths: Sequence[Path]) -> None:
    """Title, scale bar and what each colour means, in the strip to the right."""
    canvas.text(MARGIN, 34, f"map {topo_map.name}: {len(topo_map)} nodes, {len(topo_map.edges)} links", INK, 0.7)
    x, y = canvas.legend + 20, MARGIN + 20
    rows: list[tuple[str, Colour]] = [("node", NODE), ("floor driven while taught", (200, 210, 190))]
    rows += [(f"{kind.name.lower()} link", colour) for kind, colour in LINKS.items()]
    if topo_map.places:
        rows.append(("place and its heading", PLACE))
    if topo_map.docks:
        rows.append(("dock", DOCK))
    if robot is not None:
        rows.append(("robot", ROBOT))
    rows += [(path.label, path.colour) for path in paths if path.label]
    for label, colour in rows:
        canvas.box(x, y - 10, 18, 12, colour)
        canvas.text(x + 28, y, label, INK, 0.45)
        y += 26
    bar = next(length for length in (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1) if length * canvas.scale <= LEGEND - 40)
    canvas.box(x, y + 19, round(bar * canvas.scale), 2, INK)
    canvas.text(x, y + 42, f"{bar:g} m", INK, 0.45)
