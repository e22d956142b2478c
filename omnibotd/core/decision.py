"""What the control tick sees and what it decides: the values that every state machine speaks."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.percept import HomingEstimate, PlaceEstimate


class ErrorName(StrEnum):
    """Why a job failed or a request was refused; names follow nav2 and its docking server where they have one."""

    LOST = "LOST"
    BLOCKED = "BLOCKED"
    NO_MAP = "NO_MAP"
    NO_ROUTE = "NO_ROUTE"
    NO_SUCH_PLACE = "NO_SUCH_PLACE"
    BASE_LINK_DOWN = "BASE_LINK_DOWN"
    CAMERA_DOWN = "CAMERA_DOWN"
    EMERGENCY_STOP = "EMERGENCY_STOP"
    TIMEOUT = "TIMEOUT"
    CANCELLED = "CANCELLED"
    BUSY = "BUSY"
    NOT_PERMITTED = "NOT_PERMITTED"
    INVALID = "INVALID"
    STORAGE = "STORAGE"
    TRAINING_FAILED = "TRAINING_FAILED"
    DOCK_NOT_IN_DB = "DOCK_NOT_IN_DB"
    FAILED_TO_STAGE = "FAILED_TO_STAGE"
    FAILED_TO_DETECT_DOCK = "FAILED_TO_DETECT_DOCK"
    FAILED_TO_CONTROL = "FAILED_TO_CONTROL"
    FAILED_TO_CHARGE = "FAILED_TO_CHARGE"


@dataclass(frozen=True, slots=True)
class Observation:
    """Everything known at one control tick; `stamp` in monotonic seconds.

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


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a job ended: `error` is None when it was done; the message is one sentence for a person."""

    error: ErrorName | None
    message: str


@dataclass(frozen=True, slots=True)
class HomingRequest:
    """Asks perception to register the next frame with a dock's snapshot.

    With `dock_from_odom` the pose expected from odometry starts a tracking estimate; without, a full fix from nothing.
    """

    dock: str
    dock_from_odom: Pose2D | None = None


@dataclass(frozen=True, slots=True)
class Decision:
    """What a state machine wants now; `outcome` ends its job, `homing` asks for the next registration."""

    state: str
    twist: Twist2D = STOP
    outcome: Outcome | None = None
    homing: HomingRequest | None = None
    distance_remaining: float | None = None
    recoveries: int = 0
