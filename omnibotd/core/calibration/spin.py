"""Optical centre and tilt of the camera from turns on the spot.

Turning about the vertical, whatever is seen turns about the vertical's image. Where that is, is easily seen; whether
centre or tilt put it there shows in how things far off the zenith move round, and needs a wide lens and all it sees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omnibotd.core.calibration.adjustment import Adjusted, adjusted, centred
from omnibotd.core.calibration.headings import seen_headings
from omnibotd.core.calibration.looks import Look
from omnibotd.core.calibration.mismatch import from_mean, from_neighbours
from omnibotd.core.calibration.panorama import Floats, Grid, Pictures
from omnibotd.core.calibration.turn import Turn
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel

# More looks tell nothing new and take memory; fewer leave gaps.
_MOST_LOOKS, _FEWEST_LOOKS = 120, 24
# Blur (cells) of each round: first each picture with the ones before it, then with the mean of all, ever finer.
_WINDOW, _NEAR_BLURS, _BLURS = 4, (3.0, 2.0), (3.0, 1.5, 1.2, 1.2, 1.2)
# A whole turn but for one gap between looks; and a share by which wheels and sight may differ.
_WHOLE_TURN, _WHEEL_ERROR = 0.98 * 2.0 * math.pi, 0.25
# The jackknife over parts of the world says half of the error found in simulated rooms, and nothing of this (px, rad).
_HONESTY, _CENTRE_FLOOR, _TILT_FLOOR = 2.0, 0.02, math.radians(0.007)
# Beyond these 0.5 px and 0.15 degrees are not sure. Blocks displaced by this much (rad) show noise.
_WORST_CENTRE, _WORST_TILT, _WORST_MISFIT = 0.3, math.radians(0.1), math.radians(0.4)


@dataclass(frozen=True, slots=True)
class SpinResult:
    """What a turn tells of the camera's mounting.

    `centre` (px) and `tilt` (rad) as in CameraModel; their sigmas are one standard deviation; `residual` (px) is how
    far views still disagree; `turned` (rad) by sight, from the one side to the other. `verdict` is ACCEPTED or
    REJECTED; `sentence` says why, and what to do.
    """

    centre: tuple[float, float]
    tilt: tuple[float, float]
    centre_sigma: float
    tilt_sigma: float
    residual: float
    frames: int
    turned: float
    verdict: Verdict
    sentence: str


def estimate(looks: Sequence[Look], camera: CameraModel) -> SpinResult:
    """From the looks of `motions.SpinMotion`; never raises for a bad turn: the verdict is then REJECTED.

    Raises FrameError where a frame is no picture or not of the camera's size.
    """
    if len(looks) < _FEWEST_LOOKS:
        sentence = f"{len(looks)} pictures, expected {_FEWEST_LOOKS} or more; let it turn right round"
        nothing = (float(camera.width), math.pi, float(camera.width))
        return SpinResult((camera.cx, camera.cy), camera.tilt, *nothing, len(looks), 0.0, Verdict.REJECTED, sentence)
    chosen = [looks[i] for i in np.unique(np.linspace(0, len(looks) - 1, _MOST_LOOKS).round().astype(int))]
    grid, pictures = Grid.of(camera), Pictures.of([look.frame for look in chosen], camera)
    wheels = wheel_headings(chosen)
    heading = seen_headings(camera, grid, pictures, wheels)
    found = follow(Turn.start(camera, grid, heading, turn_rates(chosen)), grid, pictures)
    return judged(found, float(np.ptp(wheels)))


def follow(turn: Turn, grid: Grid, pictures: Pictures) -> Adjusted:
    """The turn that explains the pictures; neighbours in the list should be near in heading."""
    for blur in _NEAR_BLURS:
        turn = centred(turn, grid, from_neighbours(turn, grid, pictures, blur, _WINDOW))
    found = adjusted(turn, grid, from_mean(turn, grid, pictures, _BLURS[0]))
    for blur in _BLURS[1:]:
        found = adjusted(found.turn, grid, from_mean(found.turn, grid, pictures, blur))
    return found


def judged(found: Adjusted, wheels_turned: float, lenience: float = 1.0) -> SpinResult:
    """What was found, and whether to believe it; `wheels_turned` (rad) is how far the wheels went round.

    `lenience` widens what is asked of centre and tilt, for those who need them less exactly.
    """
    camera, covariance = found.turn.camera, found.covariance
    centre_sigma = math.hypot(_HONESTY * math.sqrt(float(np.trace(covariance[:2, :2]))), _CENTRE_FLOOR)
    tilt_sigma = math.hypot(_HONESTY * math.sqrt(float(np.trace(covariance[2:, 2:]))), _TILT_FLOOR)
    turned = float(np.ptp(found.turn.heading))
    spread = max(centre_sigma / _WORST_CENTRE, tilt_sigma / _WORST_TILT) / lenience
    fault = _fault(turned, wheels_turned, found.misfit, spread)
    tilt = math.degrees(math.hypot(*camera.tilt))
    good = (
        f"centre ({camera.cx:.2f}, {camera.cy:.2f}) px to {centre_sigma:.2f} px, tilt {tilt:.2f} degrees to "
        f"{math.degrees(tilt_sigma):.2f} degrees"
    )
    return SpinResult(
        (camera.cx, camera.cy),
        camera.tilt,
        centre_sigma,
        tilt_sigma,
        found.misfit * camera.fx,
        len(found.turn.heading),
        turned,
        Verdict.REJECTED if fault else Verdict.ACCEPTED,
        fault or good,
    )


def wheel_headings(looks: Sequence[Look]) -> Floats:
    """(n,) rad by odometry, not wrapped."""
    return np.unwrap([look.odom_from_base.yaw for look in looks])


def turn_rates(looks: Sequence[Look]) -> Floats:
    """(n,) rad/s by odometry."""
    return np.asarray(np.gradient(wheel_headings(looks), [look.frame.stamp for look in looks]))


def _fault(turned: float, wheels: float, misfit: float, spread: float) -> str:
    """Why this is not to be believed, and what to do; empty where it is. A `spread` beyond 1 is too wide."""
    if misfit > _WORST_MISFIT:
        return (
            f"too little to see here: views of the same thing differ by {math.degrees(misfit):.1f} degrees; turn where "
            "ceiling or walls show more, in more light, with nobody near"
        )
    if spread > 1.0:
        return (
            f"parts of the view disagree {spread:.1f} times as much as they may; turn in the middle of a room, a metre "
            "or more from walls and cupboards, with nobody near"
        )
    if turned < _WHOLE_TURN:
        return f"turned {math.degrees(turned):.0f} degrees by sight, expected 360; give it room to turn right round"
    if abs(turned - wheels) > _WHEEL_ERROR * turned:
        return (
            f"turned {math.degrees(turned):.0f} degrees by sight but {math.degrees(wheels):.0f} by the wheels: put "
            "base.ticks_per_rev, wheel_radius and wheel_separation right to a tenth, and check camera.fov_deg"
        )
    return ""
