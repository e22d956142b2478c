"""A joint normal distribution whose parts come and go: the vehicle, landmarks, frozen poses."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.slam.motion import Motion

Floats = NDArray[np.float64]
HEADING = 2  # of the vehicle, in the mean


class Belief:
    """`mean` (n,) and `covariance` (n, n): the vehicle first, (x, y, heading, ...), then parts by name.

    The covariance stays symmetric and positive definite: corrections are in Joseph's form.
    """

    def __init__(self, vehicle: Floats, covariance: Floats) -> None:
        self.mean = np.array(vehicle, dtype=float)
        self.covariance = np.array(covariance, dtype=float)
        self.vehicle = len(self.mean)
        self._spans: dict[Hashable, tuple[int, int]] = {}

    def __contains__(self, name: Hashable) -> bool:
        return name in self._spans

    @property
    def names(self) -> tuple[Hashable, ...]:
        """Of all parts but the vehicle, oldest first."""
        return tuple(self._spans)

    @property
    def pose(self) -> Floats:
        """(x, y, heading) of the vehicle, a copy."""
        return self.mean[:3].copy()

    @property
    def pose_covariance(self) -> Floats:
        return self.covariance[:3, :3].copy()

    def span(self, name: Hashable) -> slice:
        """Where a part stands in the mean."""
        start, size = self._spans[name]
        return slice(start, start + size)

    def move(self, motion: Motion) -> None:
        """The vehicle moves, the rest stands (Eq 5.4): only its own block and its cross terms change."""
        k, p = self.vehicle, self.covariance
        self.mean[:k] = motion.mean
        own = motion.jacobian @ p[:k, :k] @ motion.jacobian.T + motion.noise
        p[:k, k:] = motion.jacobian @ p[:k, k:]
        p[k:, :k] = p[:k, k:].T
        p[:k, :k] = (own + own.T) / 2.0
        self._wrap()

    def append(self, name: Hashable, mean: Floats, jacobian: Floats, noise: Floats) -> None:
        """A new part that is a function of the others (`jacobian` (m, n)) and of independent noise (m, m)."""
        n, m = len(self.mean), len(mean)
        cross = jacobian @ self.covariance
        grown = np.empty((n + m, n + m))
        grown[:n, :n], grown[n:, :n], grown[:n, n:] = self.covariance, cross, cross.T
        own = cross @ jacobian.T + noise
        grown[n:, n:] = (own + own.T) / 2.0
        self.mean, self.covariance = np.concatenate([self.mean, mean]), grown
        self._spans[name] = (n, m)

    def freeze(self, name: Hashable) -> None:
        """A copy of the pose that stays where it is, with all its correlations (§5.2.3)."""
        self.append(name, self.pose, np.eye(3, len(self.mean)), np.zeros((3, 3)))

    def replace(self, name: Hashable, mean: Floats, jacobian: Floats) -> None:
        """The part becomes a function of itself, with `jacobian` (new size, old size)."""
        n, old = len(self.mean), self.span(name)
        whole = np.zeros((len(mean), n))
        whole[:, old] = jacobian
        self.append(("replaced", name), mean, whole, np.zeros((len(mean),) * 2))
        self.remove(name)
        self._spans[name] = self._spans.pop(("replaced", name))

    def remove(self, name: Hashable) -> None:
        """Forgets a part; what is known of the rest does not change."""
        start, size = self._spans.pop(name)
        keep = np.delete(np.arange(len(self.mean)), slice(start, start + size))
        self.mean, self.covariance = self.mean[keep], self.covariance[np.ix_(keep, keep)]
        self._spans = {key: (at - size if at > start else at, m) for key, (at, m) in self._spans.items()}

    def correct(self, jacobian: Floats, noise: Floats, innovation: Floats) -> None:
        """Measurements `innovation` (m,) off, with `jacobian` (m, n) and independent variances `noise` (m,)."""
        self.shift(gain(self.covariance, jacobian, noise), jacobian, noise, innovation)

    def shift(self, gains: Floats, jacobian: Floats, noise: Floats, innovation: Floats) -> None:
        """Eq 5.7, and Eq 5.8 in Joseph's form: (I-KH) P (I-KH)' + K R K'."""
        self.mean += gains @ innovation
        left = self.covariance - gains @ (jacobian @ self.covariance)
        joseph = left - (left @ jacobian.T) @ gains.T + (gains * noise) @ gains.T
        self.covariance = (joseph + joseph.T) / 2.0
        self._wrap()

    def _wrap(self) -> None:
        self.mean[HEADING] = (self.mean[HEADING] + np.pi) % (2.0 * np.pi) - np.pi


def gain(covariance: Floats, jacobian: Floats, noise: Floats) -> Floats:
    """K = P H' S^-1, (n, m), with S = H P H' + diag(noise) (Eq 5.6)."""
    cross = jacobian @ covariance
    spread = cross @ jacobian.T + np.diag(noise)
    return np.asarray(np.linalg.solve(spread, cross).T, dtype=np.float64)
