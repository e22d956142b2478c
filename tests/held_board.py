"""Somebody holds a chessboard before the camera of a standing robot: does as told, and never holds it quite still."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration.chessboard import Board
from tests.chessboards import Lens, Placed, background, checker, extent, light

Floats = NDArray[np.float64]

ZONES = ("left", "rear left", "rear", "rear right", "right", "front right", "front", "front left")
MOVES, HOLDS = 1.2, 1.8  # s
EXPOSURE = 0.03  # s of a webcam indoors
# Instants of the exposure, shares, and places within a pixel that are looked at then.
INSTANTS = ((0.0, -0.25, -0.25), (0.33, 0.25, 0.25), (0.67, 0.25, -0.25), (1.0, -0.25, 0.25))
TREMOR = 0.004  # rad or share of the distance: a hand's
POOL = 8  # pictures of noise, in turns


@dataclass(frozen=True)
class Hold:
    """A board with its middle in the direction (zenith, heading), `away` m off, `leant` by a rotation vector."""

    zenith: float
    heading: float
    away: float
    leant: tuple[float, float, float]

    def towards(self, other: Hold, share: float) -> Hold:
        mine, its = (np.array([h.zenith, h.heading, h.away, *h.leant]) for h in (self, other))
        zenith, heading, away, *leant = (mine + share * (its - mine)).tolist()
        return Hold(zenith, heading, away, tuple(leant))

    def placed(self, board: Board) -> Placed:
        across = np.array([-math.sin(self.heading), math.cos(self.heading), 0.0])
        facing, _ = cv2.Rodrigues(across * self.zenith)
        leant, _ = cv2.Rodrigues(np.array(self.leant))
        rotation = facing @ leant
        middle = np.array([(board.columns - 1) / 2.0, (board.rows - 1) / 2.0, 0.0]) * board.square
        return Placed(rotation, facing @ np.array([0.0, 0.0, self.away]) - rotation @ middle)


class HeldBoard:
    """A world of one picture and a board that moves before it."""

    bounds = (-10.0, -10.0, 10.0, 10.0)
    dock = (9.0, 0.0, 0.0)

    def __init__(self, lens: Lens, board: Board, seed: int, moves: float = MOVES, holds: float = HOLDS) -> None:
        """Takes `moves` s from one place to the next and holds it there for `holds` s."""
        self.lens, self.board, self.fov_deg = lens, board, math.degrees(lens.fov)
        self.wanted: Sequence[str] = ()  # zones that the person was told to hold it into
        self.speed = 0.0  # px/s of the board's fastest corner in the last picture
        self._rng = np.random.default_rng(seed)
        self._moves, self._holds = moves, holds
        self._background, self._lit = background(lens, self._rng), light(lens, self._rng)
        self._noise = [self._rng.normal(0.0, 3.0, (lens.height, lens.width)) for _ in range(POOL)]
        self._from = self._to = self._somewhere(0.3)
        self._began = -math.inf

    def free(self, x: float, y: float, radius: float) -> bool:
        return max(abs(x), abs(y)) + radius <= 10.0

    def render(self, x: float, y: float, yaw: float, t: float) -> NDArray[np.uint8]:
        """(H, W, 3)"""
        poses = [self._hold(t + EXPOSURE * share).placed(self.board) for share, _, _ in INSTANTS]
        self._note_speed(poses[0], poses[-1])
        seen = [self._with_board(pose, du, dv) for pose, (_, du, dv) in zip(poses, INSTANTS, strict=True)]
        picture = np.mean(seen, axis=0)
        picture = cv2.GaussianBlur(picture * self._lit, (0, 0), 0.7) + self._noise[round(t * 10.0) % POOL] + 4.0
        return cv2.cvtColor(np.clip(picture, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)

    def _with_board(self, pose: Placed, du: float, dv: float) -> Floats:
        x0, y0, x1, y1 = extent(self.lens, self.board, pose)
        u, v = np.meshgrid(np.arange(x0, x1, dtype=float), np.arange(y0, y1, dtype=float))
        patch = checker(self.lens.rays(u + du, v + dv), self.board, pose, 0.6)
        picture = self._background.copy()
        picture[y0:y1, x0:x1] = np.where(np.isnan(patch), picture[y0:y1, x0:x1], patch)
        return picture

    def _hold(self, t: float) -> Hold:
        if t - self._began > self._moves + self._holds:
            self._began, self._from, self._to = t, self._to, self._next()
        share = min(1.0, (t - self._began) / self._moves)
        hold = self._from.towards(self._to, share * share * (3.0 - 2.0 * share))
        shaken = [TREMOR * math.sin(t * pace + k) for k, pace in enumerate((9.0, 7.3, 11.1))]
        return Hold(hold.zenith + shaken[0], hold.heading + shaken[1], hold.away * (1.0 + shaken[2]), hold.leant)

    def _next(self) -> Hold:
        """Into a part of the picture that it is wanted in, or anywhere; most of the board is in view."""
        for _ in range(1000):
            hold = self._somewhere(self._rng.uniform(0.0, 0.8 * self.lens.fov / 2.0))
            zones = [zone for zone in self.wanted if zone in ZONES]
            if zones:
                heading = (ZONES.index(zones[0]) + self._rng.uniform(-0.3, 0.3)) * math.pi / 4.0
                hold = Hold(self._rng.uniform(0.5, 0.8) * self.lens.fov / 2.0, heading, hold.away, hold.leant)
            elif self.wanted:
                hold = self._somewhere(0.2)
            if np.isfinite(self.lens.project(hold.placed(self.board).points(self.board))[:, 0]).mean() > 0.75:
                return hold
        raise AssertionError(f"nowhere to hold a {self.board} board for {self.wanted}")

    def _somewhere(self, zenith: float) -> Hold:
        longer = max(self.board.columns, self.board.rows) * self.board.square
        away = longer / 2.0 / math.tan(self._rng.uniform(0.6, 1.1) / 2.0)
        lean = self._rng.uniform(-0.5, 0.5, 3)
        return Hold(zenith, self._rng.uniform(0.0, 2.0 * math.pi), away, (lean[0], lean[1], lean[2]))

    def _note_speed(self, before: Placed, after: Placed) -> None:
        first, last = (self.lens.project(pose.points(self.board)) for pose in (before, after))
        self.speed = float(np.nan_to_num(np.hypot(*(last - first).T)).max()) / EXPOSURE
