"""The usual peer: ORB features of the rectified ceiling, and a similarity between their matches by RANSAC."""

from __future__ import annotations

import math

import cv2
import numpy as np

from omnibotd.core.docking.rectification import Rectification
from omnibotd.core.geometry import Pose2D
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

SIZE, FOV = 480, math.radians(120.0)  # at 90 degrees it fails on most ceilings
FEATURES = 1000
RATIO = 0.8  # Lowe's: a match is kept if the second best is that much worse
THRESHOLD = 3.0  # px of RANSAC
INLIERS = 10  # fewer are chance


class OrbHoming:
    """Estimates where the base stands relative to a dock; each frame by itself."""

    def __init__(self, camera: CameraModel, snapshot: Frame, ceiling_height: float) -> None:
        self._rectify = Rectification(camera, SIZE, FOV)
        self._height = ceiling_height
        self._orb = cv2.ORB_create(FEATURES)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        self._points, self._target = self.extract(self._rectify(snapshot.grey()))

    def extract(self, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) positions from the centre and (n, 32) descriptors."""
        found, descriptors = self._orb.detectAndCompute(view, self._rectify.valid)
        points = np.array([key.pt for key in found], np.float32).reshape(-1, 2) - np.float32((SIZE - 1) / 2.0)
        return points, np.zeros((0, 32), np.uint8) if descriptors is None else descriptors

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """REJECTED where fewer than ten matches agree on a similarity."""
        points, descriptors = self.extract(self._rectify(frame.grey()))
        pairs = self._matches(descriptors)
        here, there = points[pairs[:, 0]], self._points[pairs[:, 1]]
        similarity, inliers = None, np.zeros(0)
        if len(pairs) >= INLIERS:
            cv2.setRNGSeed(1)
            similarity, inliers = cv2.estimateAffinePartial2D(here, there, ransacReprojThreshold=THRESHOLD)
        if similarity is None or inliers.sum() < INLIERS:
            return HomingEstimate(frame.stamp, odom_from_base, Pose2D(), -1.0, 0.0, Verdict.REJECTED)
        share = float(inliers.mean())
        return HomingEstimate(frame.stamp, odom_from_base, self._pose(similarity), share, 1.0, Verdict.ACCEPTED)

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        return self.fix(frame, odom_from_base)

    def _matches(self, descriptors: np.ndarray) -> np.ndarray:
        """(m, 2) indices of features here and there."""
        if not len(descriptors) or len(self._target) < 2:
            return np.zeros((0, 2), np.intp)
        best = self._matcher.knnMatch(descriptors, self._target, k=2)
        kept = [(one.queryIdx, one.trainIdx) for one, two in best if one.distance < RATIO * two.distance]
        return np.array(kept, np.intp).reshape(-1, 2)

    def _pose(self, similarity: np.ndarray) -> Pose2D:
        """Where this view's axis stands in the dock's, and how far it is turned."""
        scale = self._height / self._rectify.focal
        u, v = similarity[:, 2]
        return Pose2D(-v * scale, u * scale, math.atan2(similarity[1, 0], similarity[0, 0]))
