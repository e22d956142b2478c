"""Names of failures: of jobs and of refused requests. By itself, for the client must start in a blink."""

from __future__ import annotations

from enum import StrEnum


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
    NOT_DOCKED = "NOT_DOCKED"
    CALIBRATION_FAILED = "CALIBRATION_FAILED"
    DOCK_NOT_IN_DB = "DOCK_NOT_IN_DB"
    FAILED_TO_STAGE = "FAILED_TO_STAGE"
    FAILED_TO_DETECT_DOCK = "FAILED_TO_DETECT_DOCK"
    FAILED_TO_CONTROL = "FAILED_TO_CONTROL"
    FAILED_TO_CHARGE = "FAILED_TO_CHARGE"
