"""Bearing-only SLAM by an extended Kalman filter (thesis, chapter 5): one belief over the robot and the landmarks."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.slam.bearing import of_points, of_rays, ray_point, wrapped
from omnibotd.core.slam.belief import Belief, Floats, gain
from omnibotd.core.slam.consistency import VAGUE, Health, InnovationMonitor, State
from omnibotd.core.slam.motion import VelocityNoise, WheelNoise, WheelStep, constant_velocity, wheel_motion
from omnibotd.core.slam.sighting import Bearing, Initialiser
from omnibotd.core.slam.undelayed import settle

# Normalised innovation squared beyond which a bearing is refused: 1 in 1900 honest ones.
GATE = 12.0
# The update is linearised anew at its own result so often: rays from one bearing are anything but linear.
ROUNDS = 3
# A landmark is forgotten, to be mapped anew, where most of its last bearings were refused: it moved or was never there.
REMEMBERED, CONTRADICTED = 12, 0.6
# Rebuilding a third of the map is no repair but a filter that goes wrong.
REBUILT = 3
# Variances of a start that is where the frame begins: m^2 and rad^2; of its unknown velocity, (m/s)^2 and (rad/s)^2.
_AT_ORIGIN, _VELOCITY = 1e-10, (0.1**2, 0.1**2)
# A bearing without noise would leave a covariance that is no longer positive definite (rad).
_LEAST_NOISE = np.radians(0.01)


@dataclass(frozen=True, slots=True)
class Landmark:
    """Where a landmark is in the start's frame: `point` (2,) m and `covariance` (2, 2) m^2."""

    point: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True)
class Innovations:
    """Of mapped landmarks: what is new in their bearings (m,), and its derivatives by the belief (m, n).

    `variances` (m,) rad^2 are expected of it, `squares` (m,) are in units of these; only `valid` ones mean anything.
    """

    values: Floats
    jacobian: Floats
    variances: Floats
    squares: Floats
    valid: NDArray[np.bool_]


class BearingSlam:
    """The frame is the pose at the start. `noise` (rad) is one bearing's standard deviation.

    Moves by wheels unless `moving` says that the vehicle's velocity is part of the state. `plain` is the thesis' own
    update, linearised once and believing every bearing.
    """

    def __init__(
        self,
        initialiser: Initialiser,
        noise: float,
        start: Pose2D | None = None,
        *,
        moving: bool = False,
        plain: bool = False,
    ) -> None:
        at = start or Pose2D()
        vehicle = np.array([at.x, at.y, at.yaw] + [0.0, 0.0] * moving)
        variances = [_AT_ORIGIN] * 3 + list(_VELOCITY) * moving
        self.belief = Belief(vehicle, np.diag(variances))
        self._initialiser = initialiser
        self._variance = max(noise, _LEAST_NOISE) ** 2
        self._gate, self._rounds = (np.inf, 1) if plain else (GATE, ROUNDS)
        self._monitor = InnovationMonitor()
        self._recent: dict[Hashable, deque[bool]] = {}
        self._rebuilt: Counter[Hashable] = Counter()

    @property
    def health(self) -> Health:
        """Whether the pose can be believed, from the innovations and from its own covariance."""
        health = self._monitor.health
        deviation = math.sqrt(np.trace(self.belief.covariance[:2, :2]))
        if health.state is State.CONSISTENT and deviation > VAGUE:
            return replace(health, state=State.VAGUE, reason=f"by its own account it may be {deviation:.1f} m off")
        return health

    @property
    def pose(self) -> Pose2D:
        return Pose2D(*map(float, self.belief.pose))

    @property
    def names(self) -> tuple[Hashable, ...]:
        """Of the landmarks in the map."""
        return tuple(self._recent)

    def landmark(self, name: Hashable) -> Landmark:
        """As it is known now; a ray at its likeliest depth. KeyError where it isn't mapped."""
        if name not in self._recent:
            raise KeyError(name)
        span = self.belief.span(name)
        mean, covariance = self.belief.mean[span], self.belief.covariance[span, span]
        if len(mean) == 2:
            return Landmark(mean.copy(), covariance.copy())
        point, jacobian = ray_point(mean)
        return Landmark(point, jacobian @ covariance @ jacobian.T)

    def know(self, name: Hashable, point: Floats, deviation: float) -> None:
        """A landmark known beforehand, within `deviation` (m): it fixes the frame and the scale."""
        nothing = np.zeros((2, len(self.belief.mean)))
        self.belief.append(name, np.asarray(point, dtype=float), nothing, deviation**2 * np.eye(2))
        self._recent[name] = deque(maxlen=REMEMBERED)

    def coast(self, dt: float, noise: VelocityNoise) -> None:
        """`dt` seconds at constant velocity; only where the filter was made `moving`."""
        vehicle = self.belief.mean[: self.belief.vehicle]
        self.belief.move(constant_velocity(vehicle, dt, noise))

    def roll(self, step: WheelStep, noise: WheelNoise) -> None:
        """A step of the wheels; only where the filter wasn't made `moving`."""
        self.belief.move(wheel_motion(self.belief.mean[: self.belief.vehicle], step, noise))

    def look(self, bearings: Sequence[Bearing], stamp: float) -> None:
        """One view, at `stamp` (s): mapped landmarks correct, others are on their way into the map (Algorithm 5.1).

        Of several bearings of one name none is believed: all but one are wrong, and which is anybody's guess.
        """
        times = Counter(bearing.name for bearing in bearings)
        clear = [bearing for bearing in bearings if times[bearing.name] == 1]
        mapped = [bearing for bearing in clear if bearing.name in self._recent]
        new = [bearing for bearing in clear if bearing.name not in self._recent]
        self._monitor.see(len(mapped), len(new))
        if mapped:
            self._correct(mapped)
        for bearing in new:
            if self._initialiser.sight(self.belief, bearing, self._variance, stamp):
                self._recent[bearing.name] = deque(maxlen=REMEMBERED)
        self._initialiser.end_of_view(self.belief, {bearing.name for bearing in bearings}, stamp)

    def innovations(self, bearings: Sequence[Bearing]) -> Innovations:
        """What bearings (all of mapped landmarks) would say now."""
        values, jacobian, valid = self._predicted(bearings, self.belief.mean)
        spread = np.einsum("ij,jk,ik->i", jacobian, self.belief.covariance, jacobian, optimize=True) + self._variance
        return Innovations(values, jacobian, spread, values**2 / spread, valid)

    def _correct(self, bearings: Sequence[Bearing]) -> None:
        new = self.innovations(bearings)
        accepted = new.valid & (new.squares < self._gate)
        used = [bearing for bearing, good in zip(bearings, accepted, strict=True) if good]
        whitened = self._whitened(new, accepted)
        if used:
            self._update(used)
        self._monitor.add(whitened, accepted[new.valid])
        if not (np.isfinite(self.belief.mean).all() and np.isfinite(self.belief.covariance).all()):
            self._monitor.fail("numbers of the state are no longer finite")
        for bearing, good in zip(bearings, accepted, strict=True):
            self._follow(bearing.name, bool(good))

    def _whitened(self, new: Innovations, accepted: NDArray[np.bool_]) -> Floats:
        """Squares of the accepted innovations without what they share: one error of the heading is in all bearings."""
        jacobian = new.jacobian[accepted]
        spread = jacobian @ self.belief.covariance @ jacobian.T + self._variance * np.eye(len(jacobian))
        values = np.linalg.solve(np.linalg.cholesky(spread), new.values[accepted])
        return np.asarray(values**2, dtype=np.float64)

    def _update(self, bearings: Sequence[Bearing]) -> None:
        """All at once, linearised anew at the result (iterated Kalman update)."""
        prior = self.belief.mean.copy()
        noise = np.full(len(bearings), self._variance)
        mean = prior
        for _ in range(self._rounds):
            values, jacobian, _ = self._predicted(bearings, mean)
            innovation = values - jacobian @ (prior - mean)
            gains = gain(self.belief.covariance, jacobian, noise)
            mean = prior + gains @ innovation
        self.belief.shift(gains, jacobian, noise, innovation)

    def _follow(self, name: Hashable, good: bool) -> None:
        """Makes points of rays that have settled, and forgets landmarks that contradict what is seen."""
        settle(self.belief, name)
        recent = self._recent[name]
        recent.append(good)
        if len(recent) == REMEMBERED and recent.count(False) >= CONTRADICTED * REMEMBERED:
            self.forget(name)
            self._rebuilt[name] += 1
            if len(self._rebuilt) >= REBUILT and 3 * len(self._rebuilt) >= len(self._recent):
                self._monitor.fail(f"{len(self._rebuilt)} landmarks had to be mapped anew")

    def forget(self, name: Hashable) -> None:
        """Takes a landmark out of the map."""
        del self._recent[name]
        self.belief.remove(name)

    def _predicted(self, bearings: Sequence[Bearing], mean: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Innovations (m,) at a mean, their derivatives (m, n), and which of them mean anything."""
        starts = np.array([self.belief.span(bearing.name).start for bearing in bearings])
        sizes = np.array([self.belief.span(bearing.name).stop for bearing in bearings]) - starts
        values = np.array([bearing.angle for bearing in bearings])
        jacobian, valid = np.zeros((len(bearings), len(mean))), np.ones(len(bearings), dtype=bool)
        for size, of_landmarks in ((2, of_points), (4, of_rays)):
            rows = np.flatnonzero(sizes == size)
            if len(rows):
                at = starts[rows, None] + np.arange(size)
                seen = of_landmarks(mean[:3], mean[at])
                values[rows] = wrapped(values[rows] - seen.bearings)
                jacobian[rows, :3], jacobian[rows[:, None], at], valid[rows] = (
                    seen.by_pose,
                    seen.by_landmark,
                    seen.valid,
                )
        return values, jacobian, valid
