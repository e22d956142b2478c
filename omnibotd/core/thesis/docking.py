"""Homing by the ceiling plane to the letter (thesis §7.2): edge histogram, average rows and columns, homing vector.

The view of the central 90 degrees has 480 x 480 pixels, u to the right (the robot's left), v down (its back). Lengths
are pixels; the controller takes each for STEP metres, whatever the ceiling's height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.rectification import Rectification
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image

Floats = NDArray[np.float64]

SIZE, FOV = 480, math.radians(90.0)
THRESHOLD = 150.0  # mu, of the unnormalised Sobel of 8-bit grey
BINS = 360
TEMPLATE = 192  # samples: the central 40 % of 480
START = (SIZE - TEMPLATE) // 2  # where the template lies in the target; also the farthest shift
STEP = 0.01  # m a pixel: k of Eq 7.6
# Correlation below which a shift is doubtful, and how far (degrees) from the best turn the second best is looked for:
# both [assumed], and both for the report only.
DOUBTFUL = 0.3
ELSEWHERE = 20

# Bin phi + t of a histogram turned by t, one row a turn.
_TURNED = (np.arange(BINS)[:, None] + np.arange(BINS)) % BINS


@dataclass(frozen=True, slots=True)
class Turn:
    """What the robot must turn, counter-clockwise (rad), to face as at the target.

    `margin` in [0, 1]: 1 - least over second least error, 0 where a turn elsewhere fits as well.
    """

    angle: float
    margin: float


@dataclass(frozen=True, slots=True)
class Shift:
    """Pixels from where the template was to where it is found; `ncc` its correlation there, -1 on a flat profile."""

    pixels: int
    ncc: float

    @property
    def saturated(self) -> bool:
        """At the border of the search: the truth may lie beyond."""
        return self.pixels in (-START, START - 1)


@dataclass(frozen=True)
class Profiles:
    """Differences (479,) of a view's row means and column means (Eqs 7.2 to 7.4)."""

    rows: Floats
    columns: Floats


def edge_histogram(view: Image, valid: Image) -> Floats:
    """(360,) pixels of each edge direction whose Sobel magnitude is above the threshold; none beside unseen ones."""
    dx, dy = cv2.Sobel(view, cv2.CV_32F, 1, 0), cv2.Sobel(view, cv2.CV_32F, 0, 1)
    magnitude, phi = cv2.cartToPolar(dx, dy, angleInDegrees=True)
    strong = (magnitude > THRESHOLD) & (cv2.erode(valid, np.ones((3, 3), np.uint8)) > 0)
    bins = phi[strong].astype(np.intp) % BINS
    return np.bincount(bins, minlength=BINS).astype(np.float64)


def match_histograms(target: Floats, current: Floats) -> Turn | None:
    """Eq 7.1, every whole degree tried; None where either view shows no edge."""
    if not target.any() or not current.any():
        return None
    errors = ((current[_TURNED] - target) ** 2).sum(1)
    best = int(errors.argmin())
    away = np.abs((np.arange(BINS) - best + BINS // 2) % BINS - BINS // 2)
    second = float(errors[away > ELSEWHERE].min())
    return Turn(wrap(math.radians(best)), 1.0 - float(errors[best]) / second if second > 0.0 else 0.0)


def turned(view: Image, angle: float) -> Image:
    """The view with its content turned by `angle` about the centre, from u towards v; its mean fills the corners."""
    # OpenCV's angle is counter-clockwise on the screen, where v points down.
    centre = ((SIZE - 1) / 2.0, (SIZE - 1) / 2.0)
    turn = cv2.getRotationMatrix2D(centre, -math.degrees(angle), 1.0)
    mean = cv2.mean(view)
    return np.asarray(cv2.warpAffine(view, turn, (SIZE, SIZE), borderValue=mean), np.uint8)


def profiles(view: Image) -> Profiles:
    """Eqs 7.2 to 7.4, with 480 terms in each mean."""
    return Profiles(np.diff(view.mean(1)), np.diff(view.mean(0)))


def match_profiles(target: Floats, current: Floats) -> Shift:
    """The target's central 40 % found in the current profile by normalised cross-correlation at every position."""
    template = target[START : START + TEMPLATE] - target[START : START + TEMPLATE].mean()
    windows = np.lib.stride_tricks.sliding_window_view(current, TEMPLATE)
    windows = windows - windows.mean(1, keepdims=True)
    energy = (template @ template) * np.einsum("kt,kt->k", windows, windows)
    flat = energy < 1e-12
    ncc = np.where(flat, -1.0, (windows @ template) / np.sqrt(np.where(flat, 1.0, energy)))
    best = int(ncc.argmax())
    return Shift(best - START, float(ncc[best]))


class ThesisHoming:
    """Estimates the turn and the homing vector to the pose at which the dock's snapshot was taken."""

    def __init__(self, camera: CameraModel, snapshot: Frame, ceiling_height: float) -> None:
        """`ceiling_height` plays no part: the method is not metric."""
        self._rectify = Rectification(camera, SIZE, FOV)
        target = self._rectify(snapshot.grey())
        self._histogram = edge_histogram(target, self._rectify.valid)
        self._profiles = profiles(target)

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """Each frame by itself. REJECTED where a view shows no edge, AMBIGUOUS where the shift is doubtful."""
        view = self._rectify(frame.grey())
        turn = match_histograms(self._histogram, edge_histogram(view, self._rectify.valid))
        if turn is None:
            return HomingEstimate(frame.stamp, odom_from_base, Pose2D(), -1.0, 0.0, Verdict.REJECTED)
        seen = profiles(turned(view, -turn.angle))
        v = match_profiles(self._profiles.rows, seen.rows)
        u = match_profiles(self._profiles.columns, seen.columns)
        score = min(u.ncc, v.ncc)
        doubtful = score < DOUBTFUL or u.saturated or v.saturated
        verdict = Verdict.AMBIGUOUS if doubtful else Verdict.ACCEPTED
        pose = _dock_from_base(turn.angle, u.pixels, v.pixels)
        return HomingEstimate(frame.stamp, odom_from_base, pose, score, turn.margin, verdict)

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        """The method knows no prior: as `fix`."""
        return self.fix(frame, odom_from_base)


def _dock_from_base(turn: float, u: int, v: int) -> Pose2D:
    """Eq 7.5 [Dx; Dy] = R(turn) [u; v] in the robot's axes (forward -Dy, left Dx), a pixel as STEP metres."""
    c, s = math.cos(turn), math.sin(turn)
    dx, dy = c * u - s * v, s * u + c * v
    return Pose2D(-dy * STEP, dx * STEP, turn).inverse()
