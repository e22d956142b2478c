"""What is seen round a robot that turns on the spot, unwrapped about the vertical: a turn only shifts its columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import FrameError
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import FloatImage, Frame, Image

Floats = NDArray[np.float64]

# Cells of about half a degree: a little more than a pixel of a 640x480 picture that 190 degrees fill.
COLUMNS = 720
ROW_STEP, COLUMN_STEP = math.radians(0.6), 2.0 * math.pi / COLUMNS
# Nearer the zenith a cell is a fraction of a pixel and a turn moves nothing. Beyond the other two, a centre wrong by
# 10 px brings the black surround in.
_INNERMOST, _OUTERMOST, _RIM = math.radians(8.0), math.radians(86.0), math.radians(9.0)
# Displacements are measured on blocks: large enough to hold an edge, small enough to have one depth.
_BLOCK_ROWS, _BLOCK_COLUMNS = 10, 30
SECTORS = COLUMNS // _BLOCK_COLUMNS
# Pixels are computed for one cell of so many (a divisor of a block) and interpolated: to 0.001 px, 30 times as fast.
_NODE_ROWS, _NODE_COLUMNS = 5, 6
_MARGIN = 2  # nodes round the grid that cubic interpolation reaches into
# Grey levels added before the logarithm: below them sensor noise would pass for contrast.
_DARK = 30.0
_LOGARITHM = np.log(np.arange(256, dtype=np.float32) + np.float32(_DARK))
# Cells over which brightness is evened out, and contrast (of log grey) that drowns in noise.
_BOX, _NOISE_FLOOR = 31, 0.02


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells (rows, COLUMNS) by zenith angle and bearing in the world, in blocks (rings * SECTORS), ring by ring."""

    rings: int

    @classmethod
    def of(cls, camera: CameraModel) -> Grid:
        """Whole rings of blocks within the camera's field of view."""
        outermost = min(_OUTERMOST, camera.fov / 2.0 - _RIM)
        return cls(max(1, int((outermost - _INNERMOST) / ROW_STEP / _BLOCK_ROWS)))

    @property
    def rows(self) -> int:
        return self.rings * _BLOCK_ROWS

    @property
    def zenith(self) -> Floats:
        """(rows,) zenith angles."""
        return np.asarray(_INNERMOST + (np.arange(self.rows) + 0.5) * ROW_STEP)

    @property
    def worth(self) -> FloatImage:
        """(rows, 1) how much of a pixel a cell holds, at most 1: towards the zenith they crowd."""
        return np.minimum(1.0, np.sin(self.zenith) * (COLUMN_STEP / ROW_STEP) * 1.2).astype(np.float32)[:, None]

    def blocks(self) -> tuple[Floats, Floats]:
        """Zenith angles and bearings of the blocks' centres, (rings * SECTORS,) each."""
        zenith = _INNERMOST + (np.arange(self.rings) + 0.5) * _BLOCK_ROWS * ROW_STEP
        bearing = (np.arange(SECTORS) + 0.5) * _BLOCK_COLUMNS * COLUMN_STEP
        return np.repeat(zenith, SECTORS), np.tile(bearing, self.rings)

    def sums(self, cells: FloatImage) -> Floats:
        """(rings * SECTORS,) sums over blocks."""
        blocks = cells.reshape(self.rings, _BLOCK_ROWS, SECTORS, _BLOCK_COLUMNS)
        return np.asarray(blocks.sum((1, 3), dtype=np.float64)).ravel()

    def nodes(self, of_blocks: Floats) -> tuple[Floats, Floats, Floats]:
        """Zenith angles (n, 1) and bearings (1, m) of the nodes, and there (n, m), interpolated, what blocks have."""
        row = (np.arange(-_MARGIN, self.rows // _NODE_ROWS + _MARGIN) + 0.5) * _NODE_ROWS
        column = (np.arange(-_MARGIN, COLUMNS // _NODE_COLUMNS + _MARGIN) + 0.5) * _NODE_COLUMNS
        blocks = of_blocks.reshape(self.rings, SECTORS)
        ring = np.clip(row / _BLOCK_ROWS - 0.5, 0.0, self.rings - 1.0)
        inner = np.minimum(ring.astype(int), max(0, self.rings - 2))
        outer, share = np.minimum(inner + 1, self.rings - 1), (ring - inner)[:, None]
        rings = (1.0 - share) * blocks[inner] + share * blocks[outer]
        sector = column / _BLOCK_COLUMNS - 0.5
        before = np.floor(sector).astype(int)
        share = sector - before
        values = (1.0 - share) * rings[:, before % SECTORS] + share * rings[:, (before + 1) % SECTORS]
        zenith, bearing = _INNERMOST + row * ROW_STEP, column * COLUMN_STEP
        return np.asarray(zenith[:, None]), np.asarray(bearing[None, :]), np.asarray(values)

    def between_nodes(self, nodes: Floats) -> tuple[FloatImage, FloatImage]:
        """Columns and rows (rows, COLUMNS) of the picture at the cells, from those (n, m, 2) at the nodes."""
        size = (nodes.shape[1] * _NODE_COLUMNS, nodes.shape[0] * _NODE_ROWS)
        cells = cv2.resize(nodes.astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
        top, left = _MARGIN * _NODE_ROWS, _MARGIN * _NODE_COLUMNS
        inner = cells[top:-top, left:-left]
        # Both maps float32: OpenCV 5 returns garbage, silently, when one is float64.
        return np.ascontiguousarray(inner[..., 0]), np.ascontiguousarray(inner[..., 1])


@dataclass(frozen=True, slots=True)
class View:
    """What one picture shows on the grid, 0 beyond the picture's edges; `seen` says what lies within."""

    cells: FloatImage
    seen: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Pictures:
    """Grey pictures (n, H, W), and `usual` (H, W), their mean as logarithm: vignetting, dirt on the lens.

    What stays in the picture while the robot turns tells nothing of the turn, but would hold on to it.
    """

    grey: tuple[Image, ...]
    usual: FloatImage

    @classmethod
    def of(cls, frames: Sequence[Frame], camera: CameraModel, reduction: int = 1) -> Pictures:
        """Made `reduction` times smaller; FrameError where one then has not the camera's size, or is no picture."""
        grey = tuple(_grey_of(frame, camera, reduction) for frame in frames)
        total = np.zeros((camera.height, camera.width), np.float32)
        for picture in grey:
            total += _LOGARITHM[picture]
        return cls(grey, total / np.float32(len(grey)))

    def view(self, k: int, columns: FloatImage, rows: FloatImage) -> View:
        """The k-th picture's brightness at these places, as logarithm, over the usual one there."""
        height, width = self.usual.shape
        seen = (columns >= 0.0) & (rows >= 0.0) & (columns <= width - 1.0) & (rows <= height - 1.0)
        grey = cv2.remap(self.grey[k], columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        usual = cv2.remap(self.usual, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        brightness = _LOGARITHM[grey] - np.asarray(usual, np.float32)
        brightness -= np.mean(brightness, where=seen) if seen.any() else np.float32(0.0)
        return View(np.where(seen, brightness, np.float32(0.0)), seen)


def _grey_of(frame: Frame, camera: CameraModel, reduction: int) -> Image:
    grey = frame.grey(reduction)
    if grey.shape != (camera.height, camera.width):
        size = f"{grey.shape[1]}x{grey.shape[0]}"
        raise FrameError(f"frame is {size}, the calibration is for {camera.width}x{camera.height}")
    return grey


def slopes(grid: Grid, cells: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Change of the cells for each radian of the sphere, along bearing and zenith angle."""
    wide = cv2.copyMakeBorder(cells, 0, 0, 1, 1, cv2.BORDER_WRAP)
    along = cv2.Sobel(wide, cv2.CV_32F, 1, 0, scale=1 / 8.0)[:, 1:-1]
    down = cv2.Sobel(wide, cv2.CV_32F, 0, 1, scale=1 / 8.0)[:, 1:-1]
    arc = (COLUMN_STEP * np.sin(grid.zenith)).astype(np.float32)[:, None]
    return np.asarray(along / arc, np.float32), np.asarray(down / np.float32(ROW_STEP), np.float32)


def contrast(view: View, blur: float) -> View:
    """Local contrast: about 1 on structure, 0 where there is none, whatever the light. `blur` in cells."""
    box = (int(_BOX * max(1.0, blur / 2.0)) | 1,) * 2
    margin = box[0] + math.ceil(3.0 * blur)
    wide = cv2.copyMakeBorder(view.cells, 0, 0, margin, margin, cv2.BORDER_WRAP)
    smooth = cv2.GaussianBlur(wide, (0, 0), blur)
    detail = smooth - cv2.blur(smooth, box)
    strength = cv2.sqrt(cv2.blur(detail * detail, box))
    cells = (detail / (strength + _NOISE_FLOOR))[:, margin:-margin]
    return View(np.where(view.seen, cells, np.float32(0.0)).astype(np.float32), view.seen)
