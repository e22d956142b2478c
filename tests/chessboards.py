"""Pictures of a chessboard through fisheye lenses, drawn ray by ray: what the calibration is tried on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration.chessboard import Board
from omnibotd.core.vision.frame import Image

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """r = f g(theta) px by a table of g, so that no lens here is drawn by the formula that is fitted."""

    width: int
    height: int
    f: float
    cx: float
    cy: float
    fov: float
    kind: str = "equidistant"
    aspect: float = 1.0

    def radius(self, theta: Floats) -> Floats:
        """px, along u."""
        return (
            self.f
            * {
                "equidistant": lambda: theta,
                "stereographic": lambda: 2.0 * np.tan(theta / 2.0),
                "equisolid": lambda: 2.0 * np.sin(theta / 2.0),
                "webcam": lambda: theta * (1.0 - 0.04 * theta**2 + 0.008 * theta**4),
                "pinhole": lambda: np.tan(np.minimum(theta, 1.4)),
            }[self.kind]()
        )

    def project(self, points: Floats) -> Floats:
        """(n, 2) px of points (n, 3) in camera axes; NaN out of view."""
        across = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-12)
        theta = np.arctan2(across, points[:, 2])
        scale = np.where(theta <= self.fov / 2.0, self.radius(theta) / across, np.nan)
        pixels = np.column_stack([self.cx + scale * points[:, 0], self.cy + self.aspect * scale * points[:, 1]])
        inside = (pixels >= 0).all(1) & (pixels[:, 0] <= self.width - 1) & (pixels[:, 1] <= self.height - 1)
        return np.where(inside[:, None], pixels, np.nan)

    def rays(self, u: Floats, v: Floats) -> Floats:
        """(..., 3) unit rays of pixels; NaN beyond the field of view."""
        x, y = u - self.cx, (v - self.cy) / self.aspect
        table = np.linspace(0.0, self.fov / 2.0, 4000)
        r = np.hypot(x, y)
        theta = np.interp(r, self.radius(table), table, right=np.nan)
        along = np.sin(theta) / np.maximum(r, 1e-12)
        return np.stack([x * along, y * along, np.cos(theta)], -1)

    @classmethod
    def fitting(cls, width: int, height: int, fov_deg: float, kind: str = "equidistant", fill: float = 0.98) -> Lens:
        """An image circle that fills `fill` of the smaller side (more than 1: cut off), a little off the middle."""
        fov = math.radians(fov_deg)
        unit = cls(width, height, 1.0, 0.0, 0.0, fov, kind).radius(np.array(fov / 2.0))
        centre = ((width - 1) / 2.0 + 0.011 * width, (height - 1) / 2.0 - 0.007 * height)
        return cls(width, height, fill * min(width, height) / 2.0 / float(unit), *centre, fov, kind)


@dataclass(frozen=True)
class Placed:
    """A board's pose in the camera's axes: camera from board."""

    rotation: Floats
    translation: Floats

    def points(self, board: Board) -> Floats:
        """(rows * columns, 3) its inner corners, row by row."""
        x, y = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
        flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * board.square
        return flat @ self.rotation.T + self.translation


def placed(
    lens: Lens, board: Board, rng: np.random.Generator, farthest: float, least_span: float = 0.5, whole: bool = True
) -> Placed:
    """A board held by hand, its middle at most `farthest` rad off axis, its corners all in view if `whole`."""
    while True:
        zenith, heading = farthest * math.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * math.pi)
        span = rng.uniform(least_span, 1.3)  # rad, of the board's longer side
        facing, _ = cv2.Rodrigues(np.array([-math.sin(heading), math.cos(heading), 0.0]) * zenith)
        leant, _ = cv2.Rodrigues(rng.uniform(-0.6, 0.6, 3))
        rolled, _ = cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)]))
        rotation = facing @ leant @ rolled
        longer = max(board.columns, board.rows) - 1
        depth = longer * board.square / 2.0 / math.tan(span / 2.0)
        middle = np.array([(board.columns - 1) / 2.0, (board.rows - 1) / 2.0, 0.0]) * board.square
        pose = Placed(rotation, facing @ np.array([0.0, 0.0, depth]) - rotation @ middle)
        seen = np.isfinite(lens.project(pose.points(board))[:, 0]).mean()
        if seen == 1.0 or (not whole and seen > 0.65):
            return pose


def drawn(
    lens: Lens,
    board: Board,
    pose: Placed,
    rng: np.random.Generator,
    noise: float = 3.0,
    blur: float = 0.7,
    quality: int | None = 90,
    margin: float = 0.6,
) -> Image:
    """Grey picture (H, W): the board on a cluttered background, unevenly lit, blurred, noisy, as a JPEG would be."""
    picture = background(lens, rng)
    x0, y0, x1, y1 = extent(lens, board, pose)
    fine = 2
    u = np.linspace(x0 - 1 / 4, x1 - 3 / 4, (x1 - x0) * fine)
    v = np.linspace(y0 - 1 / 4, y1 - 3 / 4, (y1 - y0) * fine)
    rays = lens.rays(*np.meshgrid(u, v))
    patch = checker(rays, board, pose, margin)
    behind = np.repeat(np.repeat(picture[y0:y1, x0:x1], fine, 0), fine, 1)
    patch = np.where(np.isnan(patch), behind, patch)
    picture[y0:y1, x0:x1] = patch.reshape(y1 - y0, fine, x1 - x0, fine).mean((1, 3))
    return _photographed(picture, lens, rng, noise, blur, quality)


def extent(lens: Lens, board: Board, pose: Placed) -> tuple[int, int, int, int]:
    """A box of pixels round the board with its margins."""
    x, y = np.meshgrid(np.linspace(-2, board.columns + 1, 40), np.linspace(-2, board.rows + 1, 40))
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * board.square
    pixels = lens.project(flat @ pose.rotation.T + pose.translation)
    low, high = np.nanmin(pixels, 0) - 3, np.nanmax(pixels, 0) + 4
    return max(int(low[0]), 0), max(int(low[1]), 0), min(int(high[0]), lens.width), min(int(high[1]), lens.height)


def checker(rays: Floats, board: Board, pose: Placed, margin: float) -> Floats:
    """Grey value where a ray meets the board or its white margin, NaN elsewhere."""
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = pose.rotation[:, 2]
        reach = (normal @ pose.translation) / (rays @ normal)
        reach[~(reach > 0)] = np.nan
        x, y, _ = np.moveaxis((rays * reach[..., None] - pose.translation) @ pose.rotation / board.square, -1, 0)
        squares = (np.floor(x) + np.floor(y)) % 2
        inked = (x > -1) & (x < board.columns) & (y > -1) & (y < board.rows)
        paper = (np.abs(x - (board.columns - 1) / 2) < (board.columns + 1) / 2 + margin) & (
            np.abs(y - (board.rows - 1) / 2) < (board.rows + 1) / 2 + margin
        )
    return np.where(inked & (squares == 1), 40.0, np.where(paper, 205.0, np.nan))


def background(lens: Lens, rng: np.random.Generator) -> Floats:
    """(H, W) clutter."""
    coarse = rng.uniform(30, 170, (lens.height // 40 + 2, lens.width // 40 + 2))
    picture = cv2.resize(coarse, (lens.width, lens.height), interpolation=cv2.INTER_CUBIC)
    for _ in range(25):
        (x, y), (w, h) = (
            rng.integers(0, [lens.width, lens.height]),
            rng.integers(8, min(lens.width, lens.height) // 4, 2),
        )
        corners = cv2.boxPoints(((float(x), float(y)), (float(w), float(h)), float(rng.uniform(0, 90))))
        cv2.fillConvexPoly(picture, corners.astype(np.int32), float(rng.uniform(10, 240)))
    return np.clip(picture, 0, 255)


def light(lens: Lens, rng: np.random.Generator) -> Floats:
    """(H, W) uneven lamps, darker towards the rim, nothing beyond it."""
    v, u = np.mgrid[: lens.height, : lens.width].astype(np.float64)
    lit = 0.75 + 0.25 * np.cos(u / lens.width * rng.uniform(1, 4) + rng.uniform(0, 6))
    r = np.hypot(u - lens.cx, (v - lens.cy) / lens.aspect)
    rim = float(lens.radius(np.array(lens.fov / 2.0)))
    return np.asarray(lit * (1.0 - 0.4 * (r / rim) ** 4) * (r <= rim))


def _photographed(
    picture: Floats, lens: Lens, rng: np.random.Generator, noise: float, blur: float, quality: int | None
) -> Image:
    picture = picture * light(lens, rng) + 4.0
    picture = cv2.GaussianBlur(picture, (0, 0), blur) if blur > 0 else picture
    grey = np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8)
    if quality is None:
        return grey
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 0), np.uint8)
