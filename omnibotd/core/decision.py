"""What the control tick sees and what it decides: the values that every state machine speaks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.percept import HomingEstimate, PlaceEstimate


@dataclass(frozen=True, slots=True)
class Observation:
    """Everything known at one control tick; `stamp` in monotonic seconds.

    `range_ahead` is metres from the robot's front edge to what is ahead, infinite where nothing is within the
    sensor's reach, None where the base has no such sensor.
    `place` and `homing` are the newest estimates and keep their own stamps: a state machine acts once on each.
    """

    stamp: float
    odom_from_base: Pose2D
    place: PlaceEstimate | None = None
    homing: HomingEstimate | None = None
    base_ok: bool = True
    camera_ok: bool = True
    bumper_left: bool = False
    bumper_right: bool = False
    cliff: bool = False
    wheel_drop: bool = False
    emergency_stop: bool = False
    charging: bool | None = None
    range_ahead: float | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a job ended: `error` is None when it was done; the message is one sentence for a person.

    `report` says by name what was seen, believed and expected at the end (SI units); finite numbers and words only.
    """

    error: ErrorName | None
    message: str
    report: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class HomingRequest:
    """Asks perception to register the next frame with a dock's snapshot.

    With `dock_from_odom` the pose expected from odometry starts a tracking estimate; without, a full fix from nothing.
    """

    dock: str
    dock_from_odom: Pose2D | None = None


@dataclass(frozen=True, slots=True)
class Decision:
    """What a state machine wants now; `outcome` ends its job, `homing` asks for the next registration.

    `waypoint` and `loop` count from 1 on a tour of several goals. `contact_expected` says that what is ahead is meant
    to be touched: the range sensor then stops nothing, bumpers still do.
    """

    state: str
    twist: Twist2D = STOP
    outcome: Outcome | None = None
    homing: HomingRequest | None = None
    distance_remaining: float | None = None
    recoveries: int = 0
    waypoint: int | None = None
    loop: int | None = None
    contact_expected: bool = False
