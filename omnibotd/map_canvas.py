"""What a map is drawn on: pixels, or the shapes of an SVG file. Coordinates are metres but for text and boxes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from html import escape
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D

Colour = tuple[int, int, int]  # BGR
Point = tuple[float, float]

BACKGROUND: Colour = (255, 255, 255)
LONG_SIDE = 900  # px of the map itself
MARGIN = 60
LEGEND = 230
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_TEXT_HEIGHT = 26  # px of OpenCV's font at size 1, for a text of the same size in SVG


class Canvas(Protocol):
    """x to the right, y up; `legend` is the pixel column at which the strip beside the map begins."""

    scale: float
    legend: int

    def at(self, x: float, y: float) -> tuple[int, int]:
        """The pixel of a point of the map."""

    def lines(self, strokes: Iterable[Iterable[Point]], colour: Colour, width: int = 1) -> None: ...

    def dots(self, points: Iterable[Point], radius: int, colour: Colour) -> None: ...

    def ring(self, x: float, y: float, radius: int, colour: Colour) -> None: ...

    def arrow(self, pose: Pose2D, length: float, colour: Colour) -> None: ...

    def text(self, x: int, y: int, words: str, colour: Colour, size: float) -> None: ...

    def box(self, x: int, y: int, width: int, height: int, colour: Colour) -> None: ...


class _Frame:
    """Where the floor from `low` to `high` (m) lies on a picture of bounded size."""

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        extent = high - low
        self.scale = LONG_SIDE / float(extent.max())
        width, height = (math.ceil(float(side) * self.scale) for side in extent)
        self.width, self.height = width + 2 * MARGIN + LEGEND, height + 2 * MARGIN
        self._low, self._bottom, self.legend = low, height + MARGIN, width + MARGIN

    def at(self, x: float, y: float) -> tuple[int, int]:
        px = MARGIN + (x - self._low[0]) * self.scale
        py = self._bottom - (y - self._low[1]) * self.scale
        return round(px), round(py)


class PixelCanvas(_Frame):
    """An image (H, W, 3) uint8 BGR."""

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        super().__init__(low, high)
        self.image = np.full((self.height, self.width, 3), BACKGROUND, np.uint8)

    def png(self) -> bytes:
        return bytes(cv2.imencode(".png", self.image)[1].tobytes())

    def lines(self, strokes: Iterable[Iterable[Point]], colour: Colour, width: int = 1) -> None:
        pixels = [np.array([self.at(x, y) for x, y in stroke], np.int32).reshape(-1, 1, 2) for stroke in strokes]
        cv2.polylines(self.image, pixels, False, colour, width, cv2.LINE_AA)

    def dots(self, points: Iterable[Point], radius: int, colour: Colour) -> None:
        for x, y in points:
            cv2.circle(self.image, self.at(x, y), radius, colour, -1, cv2.LINE_AA)

    def ring(self, x: float, y: float, radius: int, colour: Colour) -> None:
        cv2.circle(self.image, self.at(x, y), radius, colour, 2, cv2.LINE_AA)

    def arrow(self, pose: Pose2D, length: float, colour: Colour) -> None:
        tip = pose.transform(length, 0.0)
        cv2.arrowedLine(self.image, self.at(pose.x, pose.y), self.at(*tip), colour, 3, cv2.LINE_AA, tipLength=0.35)

    def text(self, x: int, y: int, words: str, colour: Colour, size: float) -> None:
        cv2.putText(self.image, words, (x, y), _FONT, size, BACKGROUND, 4, cv2.LINE_AA)
        cv2.putText(self.image, words, (x, y), _FONT, size, colour, 1, cv2.LINE_AA)

    def box(self, x: int, y: int, width: int, height: int, colour: Colour) -> None:
        cv2.rectangle(self.image, (x, y), (x + width, y + height), colour, -1)


class SvgCanvas(_Frame):
    """Shapes in an SVG file; many of one kind are one path, so that a map of 100,000 links stays a few megabytes."""

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        super().__init__(low, high)
        self._shapes: list[str] = []

    def svg(self) -> bytes:
        size = f'width="{self.width}" height="{self.height}" viewBox="0 0 {self.width} {self.height}"'
        head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif">'
        ground = f'<rect width="100%" height="100%" fill="{_css(BACKGROUND)}"/>'
        return "\n".join([head, ground, *self._shapes, "</svg>\n"]).encode()

    def lines(self, strokes: Iterable[Iterable[Point]], colour: Colour, width: int = 1) -> None:
        ways = ["M" + "L".join("{} {}".format(*self.at(x, y)) for x, y in stroke) for stroke in strokes]
        self._path("".join(ways), colour, width)

    def dots(self, points: Iterable[Point], radius: int, colour: Colour) -> None:
        """Round ends of lines of no length: the shortest way to say many dots."""
        self._path("".join("M{} {}h0".format(*self.at(x, y)) for x, y in points), colour, 2 * radius)

    def ring(self, x: float, y: float, radius: int, colour: Colour) -> None:
        px, py = self.at(x, y)
        stroke = f'fill="none" stroke="{_css(colour)}" stroke-width="2"'
        self._shapes.append(f'<circle cx="{px}" cy="{py}" r="{radius}" {stroke}/>')

    def arrow(self, pose: Pose2D, length: float, colour: Colour) -> None:
        tip = pose.transform(length, 0.0)
        barbs = [pose.transform(0.7 * length, side * 0.2 * length) for side in (1, -1)]
        self.lines([[(pose.x, pose.y), tip], [barbs[0], tip, barbs[1]]], colour, 3)

    def text(self, x: int, y: int, words: str, colour: Colour, size: float) -> None:
        halo = f'paint-order="stroke" stroke="{_css(BACKGROUND)}" stroke-width="3"'
        style = f'font-size="{_TEXT_HEIGHT * size:.0f}" fill="{_css(colour)}" {halo}'
        self._shapes.append(f'<text x="{x}" y="{y}" {style}>{escape(words)}</text>')

    def box(self, x: int, y: int, width: int, height: int, colour: Colour) -> None:
        self._shapes.append(f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="{_css(colour)}"/>')

    def _path(self, way: str, colour: Colour, width: int) -> None:
        if way:
            style = f'fill="none" stroke="{_css(colour)}" stroke-width="{width}"'
            self._shapes.append(f'<path d="{way}" {style} stroke-linecap="round" stroke-linejoin="round"/>')


def _css(colour: Colour) -> str:
    blue, green, red = colour
    return f"#{red:02x}{green:02x}{blue:02x}"
