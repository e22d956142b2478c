"""Where one frame stands in another, in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """Where frame `b` stands in frame `a` (metres); name variables `a_from_b`, so that `a_from_b @ b_from_c` works."""

    rotation: Floats  # (3, 3)
    translation: Floats  # (3,)

    @classmethod
    def of(cls, turn: ArrayLike = (0.0, 0.0, 0.0), shift: ArrayLike = (0.0, 0.0, 0.0)) -> Rigid:
        """From a rotation vector (rad) and a translation (m)."""
        return cls(rotation_matrix(np.asarray(turn, np.float64)), np.asarray(shift, np.float64))

    def __matmul__(self, other: Rigid) -> Rigid:
        return Rigid(self.rotation @ other.rotation, self.points(other.translation))

    def points(self, points: Floats) -> Floats:
        """Points (..., 3) of the inner frame, in the outer one."""
        return self.directions(points) + self.translation

    def directions(self, vectors: Floats) -> Floats:
        """Directions (..., 3) of the inner frame, in the outer one."""
        return vectors @ self.rotation.T

    def inverse(self) -> Rigid:
        back = self.rotation.T
        return Rigid(back, -(back @ self.translation))


def rotation_matrix(vector: Floats) -> Floats:
    """The rotation (3, 3) about `vector` by its length in radians (Rodrigues)."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(vector))
    half = np.sinc(angle / (2.0 * np.pi))  # sin(angle / 2) / (angle / 2): exact down to no turn at all
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * (cross @ cross), np.float64)
