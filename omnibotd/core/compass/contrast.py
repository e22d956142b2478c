"""The picture that key views are made of and compared with: levelled, and blind to the light's strength."""

from __future__ import annotations

import cv2
import numpy as np

from omnibotd.core.compass.round_view import Levelling
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import FloatImage, Frame

# Pixels per radian looked at, about: FINE to measure, COARSE to find what moved by up to 10 degrees since.
FINE, COARSE = 75.0, 19.0
# Blur that takes the noise off, and the surroundings that brightness is measured against, in pixels.
_BLUR, _SURROUNDINGS = 1.0, (17, 17)
# How far the end of what is seen makes itself felt: a square of so many pixels.
_RIM = (9, 9)
# Shadow and exposure multiply brightness, which a logarithm turns into a sum that its surroundings take away again; 10
# keeps the noise of dark places small. In units of 1/40 of a power of e.
_LOGARITHM = (40.0 * np.log(np.arange(256) + 10.0)).astype(np.float32)


class Contrast:
    """Turns frames of one camera into contrast against their surroundings."""

    def __init__(self, camera: CameraModel, focal: float = FINE) -> None:
        reduction = next((k for k in (8, 4, 2) if camera.fx / k >= 0.9 * focal), 1)
        self._levelled = Levelling(camera, reduction)
        self.focal = camera.reduced(reduction).fx  # pixels of zenith angle per radian
        self.centre = int(self._levelled.ring.u)  # of rows and columns: the zenith
        self.size = 2 * self.centre + 1
        # Where the camera's view ends there is contrast, too.
        self.seen = np.asarray(cv2.erode(self._levelled.seen, np.ones(_RIM, np.uint8)), np.uint8)

    def __call__(self, frame: Frame) -> FloatImage:
        """(size, size), bearing b at (centre + r cos b, centre + r sin b). FrameError where it can't be used."""
        smooth = cv2.GaussianBlur(_LOGARITHM[self._levelled(frame).grey], (0, 0), _BLUR)
        return np.asarray(smooth - cv2.blur(smooth, _SURROUNDINGS), np.float32)


def slopes(picture: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Change a pixel along columns and rows (Sobel's over 8: a true derivative)."""
    du, dv = (cv2.Sobel(picture, cv2.CV_32F, *order, scale=1 / 8.0) for order in ((1, 0), (0, 1)))
    return np.asarray(du, np.float32), np.asarray(dv, np.float32)
