"""The camera: a fisheye lens (Kannala-Brandt, OpenCV's `fisheye`) mounted looking at the ceiling.

Rays are in the base frame: x forward, y left, z up. An upward camera is not mirrored: with the top of the image towards
the robot's front, the right of the image is the robot's left, so image axes (u, v) are base axes (y, -x).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnibotd.core.errors import CoreError

Floats = NDArray[np.float64]

# Axes of the camera (u right, v down, optical axis) in those of its mount (x towards image top, y left, z up).
_CAMERA_FROM_MOUNT = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class CameraModelError(CoreError):
    """A calibration that describes no usable lens."""


@dataclass(frozen=True)
class CameraModel:
    """Lens and mounting. Pixel centres are whole numbers; angles in radians.

    r(theta) = f * (theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9); `fov` is the full angle of view.
    `mount_yaw` is the direction of the image's top in the base frame; `tilt` = (about x, about y) is the rotation
    vector that turns the vertical into the optical axis, in the mount's axes (x towards image top, y left).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    fov: float = math.radians(190.0)
    mount_yaw: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def equidistant(
        cls,
        width: int,
        height: int,
        fov: float,
        radius: float | None = None,
        centre: tuple[float, float] | None = None,
    ) -> CameraModel:
        """Ideal fisheye whose image circle has `radius` px (default: it just fits the smaller side)."""
        f = (min(width, height) / 2.0 if radius is None else radius) / (fov / 2.0)
        cx, cy = ((width - 1) / 2.0, (height - 1) / 2.0) if centre is None else centre
        return cls(width, height, f, f, cx, cy, fov=fov)

    @classmethod
    def from_camera_info(cls, info: Mapping[str, Any], fov: float) -> CameraModel:
        """From the ROS camera_info layout with distortion model `equidistant` or `fisheye` (OpenCV's k1..k4)."""
        try:
            k = [float(value) for value in info["camera_matrix"]["data"]]
            d = [float(value) for value in info["distortion_coefficients"]["data"]]
            width, height = int(info["image_width"]), int(info["image_height"])
            model = str(info.get("distortion_model", "equidistant"))
        except (KeyError, TypeError, ValueError) as error:
            raise CameraModelError(f"camera_info: missing or malformed {error}") from error
        if model not in ("equidistant", "fisheye"):
            raise CameraModelError(f"camera_info: distortion_model {model!r}, expected 'equidistant' (OpenCV fisheye)")
        if len(k) != 9 or len(d) != 4:
            raise CameraModelError(f"camera_info: {len(k)} matrix and {len(d)} distortion values, expected 9 and 4")
        return cls(width, height, k[0], k[4], k[2], k[5], (d[0], d[1], d[2], d[3]), fov=fov)

    @property
    def rotation(self) -> Floats:
        """(3, 3) camera axes from base axes."""
        c, s = math.cos(self.mount_yaw), math.sin(self.mount_yaw)
        mount_from_base = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        tilt, _ = cv2.Rodrigues(np.array([self.tilt[0], self.tilt[1], 0.0]))
        return np.asarray(_CAMERA_FROM_MOUNT @ tilt.T @ mount_from_base, np.float64)

    def project(self, rays: ArrayLike) -> Floats:
        """Pixels (..., 2) of rays (..., 3) in the base frame; NaN outside the field of view."""
        x, y, z = np.moveaxis(np.asarray(rays, np.float64) @ self.rotation.T, -1, 0)
        across = np.hypot(x, y)
        theta = np.arctan2(across, z)
        r = theta * self._stretch(theta)
        scale = np.where(across > 1e-12, r / np.maximum(across, 1e-12), 0.0)
        pixels = np.stack([self.cx + self.fx * scale * x, self.cy + self.fy * scale * y], -1)
        pixels[theta > self.fov / 2.0] = np.nan
        return pixels

    def unproject(self, pixels: ArrayLike) -> Floats:
        """Unit rays (..., 3) in the base frame of pixels (..., 2); NaN outside the field of view."""
        p = np.asarray(pixels, np.float64)
        x, y = (p[..., 0] - self.cx) / self.fx, (p[..., 1] - self.cy) / self.fy
        r = np.hypot(x, y)
        theta = r.copy()
        k = self.distortion
        for _ in range(20):  # Newton on r(theta) = r; quadratic, 20 is ample to 1e-12
            t2 = theta * theta
            slope = 1.0 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
            theta = theta - (theta * self._stretch(theta) - r) / np.where(np.abs(slope) > 1e-6, slope, 1.0)
        along = np.where(r > 1e-12, np.sin(theta) / np.maximum(r, 1e-12), 0.0)
        rays = np.stack([x * along, y * along, np.cos(theta)], -1) @ self.rotation
        rays[(theta > self.fov / 2.0) | (theta < 0.0)] = np.nan
        return np.asarray(rays, np.float64)

    def reduced(self, reduction: int) -> CameraModel:
        """The model of the same image made `reduction` times smaller by averaging blocks of pixels."""
        s = 1.0 / reduction
        return replace(
            self,
            width=-(-self.width // reduction),
            height=-(-self.height // reduction),
            fx=self.fx * s,
            fy=self.fy * s,
            cx=(self.cx + 0.5) * s - 0.5,
            cy=(self.cy + 0.5) * s - 0.5,
        )

    def _stretch(self, theta: Floats) -> Floats:
        t2 = theta * theta
        k = self.distortion
        return np.asarray(1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
