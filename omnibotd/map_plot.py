"""A picture of a map that a stranger understands: floor, nodes, links, places, docks, the robot, paths, a scale."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import EdgeKind, TopoMap

Colour = tuple[int, int, int]  # BGR

BACKGROUND: Colour = (255, 255, 255)
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
INK: Colour = (60, 60, 60)
GRID: Colour = (228, 228, 228)

LONG_SIDE = 900  # px of the map itself
MARGIN = 60
LEGEND = 230
FLOOR_RADIUS = 0.3  # m, as far as the robot takes the floor to be free beside where it was driven
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class Path:
    """A line to draw over the map: poses in the map, and what the legend says."""

    points: Sequence[tuple[float, float]]
    colour: Colour
    label: str


class Canvas:
    """Pixels with map coordinates: x to the right, y up, metres."""

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        extent = high - low
        self.scale = LONG_SIDE / float(extent.max())
        width, height = (math.ceil(float(side) * self.scale) for side in extent)
        self.image = np.full((height + 2 * MARGIN, width + 2 * MARGIN + LEGEND, 3), BACKGROUND, np.uint8)
        self._low, self._bottom, self.right = low, height + MARGIN, width + MARGIN

    def at(self, x: float, y: float) -> tuple[int, int]:
        px = MARGIN + (x - self._low[0]) * self.scale
        py = self._bottom - (y - self._low[1]) * self.scale
        return round(px), round(py)

    def line(self, points: Iterable[tuple[float, float]], colour: Colour, width: int = 1) -> None:
        pixels = np.array([self.at(x, y) for x, y in points], np.int32).reshape(-1, 1, 2)
        cv2.polylines(self.image, [pixels], False, colour, width, cv2.LINE_AA)

    def dot(self, x: float, y: float, radius: int, colour: Colour) -> None:
        cv2.circle(self.image, self.at(x, y), radius, colour, -1, cv2.LINE_AA)

    def arrow(self, pose: Pose2D, length: float, colour: Colour) -> None:
        tip = pose.transform(length, 0.0)
        cv2.arrowedLine(self.image, self.at(pose.x, pose.y), self.at(*tip), colour, 3, cv2.LINE_AA, tipLength=0.35)

    def text(self, x: int, y: int, words: str, colour: Colour = INK, size: float = 0.5) -> None:
        cv2.putText(self.image, words, (x, y), _FONT, size, BACKGROUND, 4, cv2.LINE_AA)
        cv2.putText(self.image, words, (x, y), _FONT, size, colour, 1, cv2.LINE_AA)


def plot_png(topo_map: TopoMap, robot: Pose2D | None = None, paths: Sequence[Path] = ()) -> bytes:
    """The map as PNG bytes, with the robot's pose and paths where given."""
    canvas = draw(topo_map, robot, paths)
    return bytes(cv2.imencode(".png", canvas.image)[1].tobytes())


def draw(topo_map: TopoMap, robot: Pose2D | None, paths: Sequence[Path]) -> Canvas:
    """The map on a canvas, to which a caller may add."""
    positions = np.asarray(topo_map.poses[:, :2], np.float64)
    drawn = [positions, *(np.array(path.points, np.float64).reshape(-1, 2) for path in paths)]
    points = np.concatenate(drawn)
    canvas = Canvas(points.min(axis=0) - 2 * FLOOR_RADIUS, points.max(axis=0) + 2 * FLOOR_RADIUS)
    for x, y in positions:
        canvas.dot(x, y, round(FLOOR_RADIUS * canvas.scale), FLOOR)
    _grid(canvas, points.min(axis=0), points.max(axis=0))
    _links(canvas, topo_map, positions)
    for x, y in positions:
        canvas.dot(x, y, 2, NODE)
    for path in paths:
        canvas.line(path.points, path.colour, 2)
    _marks(canvas, topo_map, robot)
    _legend(canvas, topo_map, robot, paths)
    return canvas


def _grid(canvas: Canvas, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Lines every metre with their coordinates."""
    for x in range(math.ceil(low[0] - FLOOR_RADIUS), math.floor(high[0] + FLOOR_RADIUS) + 1):
        canvas.line([(x, low[1] - FLOOR_RADIUS), (x, high[1] + FLOOR_RADIUS)], GRID)
        px, py = canvas.at(x, low[1] - FLOOR_RADIUS)
        canvas.text(px - 12, py + 22, f"{x} m", INK, 0.4)
    for y in range(math.ceil(low[1] - FLOOR_RADIUS), math.floor(high[1] + FLOOR_RADIUS) + 1):
        canvas.line([(low[0] - FLOOR_RADIUS, y), (high[0] + FLOOR_RADIUS, y)], GRID)
        px, py = canvas.at(low[0] - FLOOR_RADIUS, y)
        canvas.text(px - 38, py + 4, f"{y} m", INK, 0.4)


def _links(canvas: Canvas, topo_map: TopoMap, positions: NDArray[np.float64]) -> None:
    edges = topo_map.edges
    for kind, colour in LINKS.items():
        for k in np.flatnonzero(edges.kind == kind):
            a, b = positions[edges.first[k]], positions[edges.second[k]]
            canvas.line([(a[0], a[1]), (b[0], b[1])], colour)


def _marks(canvas: Canvas, topo_map: TopoMap, robot: Pose2D | None) -> None:
    poses = [(name, pose, PLACE) for name, pose in topo_map.places.items()]
    poses += [(name, dock.map_from_dock, DOCK) for name, dock in topo_map.docks.items()]
    for name, pose, colour in poses:
        canvas.dot(pose.x, pose.y, 7, colour)
        canvas.arrow(pose, 0.3, colour)
        px, py = canvas.at(pose.x, pose.y)
        canvas.text(px + 10, py - 10, name, colour, 0.6)
    if robot is not None:
        cv2.circle(canvas.image, canvas.at(robot.x, robot.y), round(0.17 * canvas.scale), ROBOT, 2, cv2.LINE_AA)
        canvas.arrow(robot, 0.25, ROBOT)


def _legend(canvas: Canvas, topo_map: TopoMap, robot: Pose2D | None, paths: Sequence[Path]) -> None:
    """Title, scale bar and what each colour means, in the strip to the right."""
    canvas.text(MARGIN, 34, f"map {topo_map.name}: {len(topo_map)} nodes, {len(topo_map.edges)} links", INK, 0.7)
    x, y = canvas.right + 20, MARGIN + 20
    rows: list[tuple[str, Colour]] = [("node", NODE), ("floor driven while taught", (200, 210, 190))]
    rows += [(f"{kind.name.lower()} link", colour) for kind, colour in LINKS.items()]
    if topo_map.places:
        rows.append(("place and its heading", PLACE))
    if topo_map.docks:
        rows.append(("dock", DOCK))
    if robot is not None:
        rows.append(("robot", ROBOT))
    rows += [(path.label, path.colour) for path in paths]
    for label, colour in rows:
        cv2.rectangle(canvas.image, (x, y - 10), (x + 18, y + 2), colour, -1)
        canvas.text(x + 28, y, label, INK, 0.45)
        y += 26
    bar = next(length for length in (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1) if length * canvas.scale <= LEGEND - 40)
    cv2.line(canvas.image, (x, y + 20), (x + round(bar * canvas.scale), y + 20), INK, 2)
    canvas.text(x, y + 42, f"{bar:g} m", INK, 0.45)
