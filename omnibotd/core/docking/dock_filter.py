"""Where the dock is: by the newest fix, or by one from nearer, carried on by odometry, where that knows it better.

A fix is right to a millimetre in the dock and to centimetres half a metre away, where in other light it errs one way
for as long as the robot stands there. Who backed out of the dock knows it best from before, by odometry.
"""

from __future__ import annotations

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate

# Variance that driving a metre adds (m2, rad2): wheels of a cheap base slip. And the share of a turn it is wrong by.
_SLIP, _SLIP_YAW, _TURN = 0.005**2, 0.025**2, 0.02**2
# A fix this many times surer (in variance) than what is known counts alone; one that is no surer, not at all.
_SURER = 2.0
# Variances of a pose of which nothing is known, and of a fix that doesn't say its own.
_UNKNOWN, _SURE = 1e6, 1e-12
# An innovation of more sigmas than this was no noise: the wheels spun, or the fixes before were wrong.
_SURPRISE = 3.0


class DockFilter:
    """`dock_from_odom` as it is known now."""

    def __init__(self, dock_from_odom: Pose2D, odom_from_base: Pose2D) -> None:
        """Of how much the start knows, nothing is known: the first fix counts alone."""
        self.dock_from_odom = dock_from_odom
        self._odom = odom_from_base
        self._variance = self._variance_yaw = _UNKNOWN  # of the base's pose in the dock's frame, at `_odom`

    def update(self, fix: HomingEstimate) -> None:
        """Takes a fix; one that doesn't say how sure it is replaces what was known."""
        expected = self.dock_from_odom @ fix.odom_from_base
        self._predict(fix.odom_from_base)
        found, (noise, noise_yaw) = fix.dock_from_base, _noise(fix)
        dx, dy, turn = found.x - expected.x, found.y - expected.y, wrap(found.yaw - expected.yaw)
        share, self._variance = _share(self._variance, noise, (dx**2 + dy**2) / 2.0)
        share_yaw, self._variance_yaw = _share(self._variance_yaw, noise_yaw, turn**2)
        fused = Pose2D(expected.x + share * dx, expected.y + share * dy, wrap(expected.yaw + share_yaw * turn))
        self.dock_from_odom = fused @ fix.odom_from_base.inverse()

    def _predict(self, odom_from_base: Pose2D) -> None:
        moved = self._odom.distance(odom_from_base)
        turned = wrap(odom_from_base.yaw - self._odom.yaw)
        self._odom = odom_from_base
        self._variance += self._variance_yaw * moved**2 / 2.0 + _SLIP * moved
        self._variance_yaw += _SLIP_YAW * moved + _TURN * turned**2


def _noise(fix: HomingEstimate) -> tuple[float, float]:
    if fix.covariance is None:
        return _SURE, _SURE
    return float(fix.covariance[0, 0] + fix.covariance[1, 1]) / 2.0, float(fix.covariance[2, 2])


def _share(variance: float, noise: float, surprise: float) -> tuple[float, float]:
    """What share of the innovation, whose square is `surprise`, to take; and the variance then.

    Fixes from one place err alike, so that many of them know no more than one: none is averaged with another, and a
    vaguer one counts for nothing however often it is repeated.
    """
    if surprise > _SURPRISE**2 * (variance + noise):
        variance = surprise
    share = min(max((variance / noise - 1.0) / (_SURER - 1.0), 0.0), 1.0)
    return share, (1.0 - share) * variance + share * noise
