"""Where the robot may be: a handful of poses carried along by odometry and weighed by what the camera sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D

Floats = NDArray[np.float64]

# More than a periodic ceiling has tiles worth telling apart in a room; the least likely are dropped.
_MOST = 30
# A candidate speaks for a hypothesis within this distance and turn; two closer than half of it are one.
_NEAR, _NEAR_TURN = 0.4, 0.35
# Correlation difference that makes a pose e times less likely in one independent frame.
_TEMPERATURE = 0.05
# The same for the fit of the view predicted at a pose: sharper, for the distance to the nodes is accounted for. Under
# identical lamps every 1.8 m the true pose led by 0.05 in half the frames, by 0.035 in nine of ten.
_FIT_TEMPERATURE = 0.02
# What a hypothesis nobody speaks for, and one frame, may lose at most: one bad frame shall not decide.
_UNSUPPORTED, _WORST = 0.25, 4.0
# Prior of having been carried to any new candidate, against having driven here.
_KIDNAPPED = -4.0


class Hypotheses:
    """poses (H, 3), log weights (H,) normalised, and standard deviations (H,) in metres; sorted, likeliest first."""

    def __init__(self) -> None:
        self.poses: Floats = np.zeros((0, 3))
        self.log_weights: Floats = np.zeros(0)
        self.sigmas: Floats = np.zeros(0)

    def __len__(self) -> int:
        return len(self.poses)

    def move(self, step: Pose2D) -> None:
        """Carry all along: `step` is the pose of the base in the one before, by odometry."""
        c, s = np.cos(self.poses[:, 2]), np.sin(self.poses[:, 2])
        self.poses[:, 0] += c * step.x - s * step.y
        self.poses[:, 1] += s * step.x + c * step.y
        self.poses[:, 2] = _wrapped(self.poses[:, 2] + step.yaw)
        # 5 % of the way, and the arc that 5 % of the turn makes at the odometry's lever of 10 cm.
        self.sigmas = np.hypot(self.sigmas, 0.05 * np.hypot(step.x, step.y) + 0.005 * abs(step.yaw))

    def supported(self, poses: Floats, scores: Floats) -> Floats:
        """(H,) best score of the candidates (C, 3), (C,) near each hypothesis; -1 where there is none."""
        return np.asarray(np.where(_near(self.poses, poses), scores, -1.0).max(1, initial=-1.0))

    def weigh(self, poses: Floats, scores: Floats, allowance: Floats, evidence: float) -> None:
        """Reweigh by candidates; `evidence` in (0, 1] says how independent this frame is of the last one.

        `allowance` (H,) is correlation forgiven to each: where no node is near, none can speak for it.
        """
        if not len(self):
            return
        top = scores.max(initial=-1.0)
        support = np.maximum(self.supported(poses, scores), top - _UNSUPPORTED) + allowance
        self.log_weights += evidence * np.clip((support - top) / _TEMPERATURE, -_WORST, 0.0)
        self._tidy()

    def judge(self, shortfalls: Floats, costs: Floats, evidence: float) -> int:
        """Reweigh the likeliest by how much worse each fits than it should, and by log odds against it; returns which
        of them is the likeliest now."""
        worse = shortfalls - shortfalls.min()
        self.log_weights[: len(worse)] -= evidence * np.minimum(worse / _FIT_TEMPERATURE, _WORST) + costs
        likeliest = int(self.log_weights[: len(worse)].argmax())
        self._tidy()
        return likeliest

    def propose(self, poses: Floats, scores: Floats, sigmas: Floats) -> None:
        """Add candidates (C, 3), (C,) good to `sigmas` (C,) metres that no hypothesis stands near, best first."""
        prior = _KIDNAPPED if len(self) else 0.0
        top = float(scores.max(initial=-1.0))
        apart = np.flatnonzero(~_near(self.poses, poses).any(0))
        among = _near(poses[apart], poses[apart])
        new: list[int] = []
        for k in range(len(apart)):
            if not among[new, k].any():
                new.append(k)
        if new:
            chosen = apart[new]
            self.poses = np.vstack([self.poses, poses[chosen]])
            self.log_weights = np.append(self.log_weights, prior + (scores[chosen] - top) / _TEMPERATURE)
            self.sigmas = np.append(self.sigmas, sigmas[chosen])
            self._tidy()

    def place(self, index: int, pose: Pose2D, sigma: float) -> None:
        """Put one hypothesis where a measurement that took it as its prior says."""
        self.poses[index] = pose.x, pose.y, _wrapped(np.asarray(pose.yaw))
        self.sigmas[index] = sigma

    def pose(self, number: int) -> Pose2D:
        """Number 0 is the likeliest."""
        x, y, yaw = (float(value) for value in self.poses[number])
        return Pose2D(x, y, yaw)

    def share(self) -> float:
        """Posterior weight of the likeliest pose."""
        return float(np.exp(self.log_weights[0])) if len(self) else 0.0

    def _tidy(self) -> None:
        """Sort, merge the ones that have run together, forget the hopeless, normalise."""
        if len(self) == 1:  # under most ceilings
            self.log_weights = np.zeros(1)
            return
        order = np.argsort(-self.log_weights, kind="stable")[:_MOST]
        self.poses, self.log_weights, self.sigmas = self.poses[order], self.log_weights[order], self.sigmas[order]
        duplicate = np.tril(_near(self.poses, self.poses, 0.5), -1).any(1)
        keep = ~duplicate & (self.log_weights > self.log_weights.max(initial=-np.inf) - 12.0)
        weights = np.exp(self.log_weights - self.log_weights.max(initial=-np.inf))
        self.poses, self.sigmas, weights = self.poses[keep], self.sigmas[keep], weights[keep]
        self.log_weights = np.log(weights / weights.sum())


def _near(some: Floats, others: Floats, share: float = 1.0) -> NDArray[np.bool_]:
    """(S, O): which of `some` poses (S, 3) speak for which of the `others` (O, 3), or stand within a share of that."""
    difference = some[:, None] - others
    close = np.hypot(difference[..., 0], difference[..., 1]) < share * _NEAR
    return np.asarray(close & (np.abs(_wrapped(difference[..., 2])) < share * _NEAR_TURN))


def _wrapped(angle: Floats) -> Floats:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))
