"""For all tests: OpenCV on one thread, so that sums are added in the same order each time."""

from __future__ import annotations

import cv2

cv2.setNumThreads(1)
