"""Parameters of a request, checked before anything moves."""

from __future__ import annotations

import math
import re
from typing import Any

from omnibotd.control_protocol import INVALID_PARAMS, RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


class Params:
    """The parameters of one request: each is taken once with its type; what is left over is an error."""

    def __init__(self, values: dict[str, Any]) -> None:
        self._values = dict(values)

    def number(self, key: str, default: float | None = None) -> float:
        value = self._values.pop(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise invalid(f"{key}: {value!r} given, expected a number")
        return float(value)

    def name(self, key: str) -> str:
        value = self._values.pop(key, None)
        if not isinstance(value, str) or not _NAME.fullmatch(value):
            raise invalid(f"{key}: {value!r} given, expected a name of letters, digits, - and _ (at most 64)")
        return value

    def names(self, key: str) -> list[str]:
        values = self._values.pop(key, None)
        if not isinstance(values, list):
            raise invalid(f"{key}: {values!r} given, expected a list of names")
        return [Params({key: value}).name(key) for value in values]

    def whole(self, key: str, default: int | None, low: int, high: int) -> int:
        value = self._values.pop(key, None)
        value = default if value is None else value
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise invalid(f"{key}: {value!r} given, expected a whole number from {low} to {high}")
        return value

    def flag(self, key: str) -> bool:
        value = self._values.pop(key, None)
        if value is not None and not isinstance(value, bool):
            raise invalid(f"{key}: {value!r} given, expected true or false")
        return bool(value)

    def text(self, key: str, limit: int) -> str:
        """Up to `limit` characters of ASCII."""
        value = self._values.pop(key, None)
        if not isinstance(value, str) or len(value) > limit or not value.isascii():
            raise invalid(f"{key}: expected a text of at most {limit} characters")
        return value

    def pose(self, key: str) -> Pose2D | None:
        value = self._values.pop(key, None)
        if value is None:
            return None
        numbers = isinstance(value, list) and len(value) == 3
        if not numbers or not all(isinstance(v, int | float) and math.isfinite(v) for v in value):
            raise invalid(f"{key}: {value!r} given, expected [x, y, yaw] in metres and radians")
        return Pose2D(*(float(v) for v in value))

    def __contains__(self, key: str) -> bool:
        return self._values.get(key) is not None

    def end(self) -> None:
        if any(value is not None for value in self._values.values()):
            raise invalid(f"unknown parameter {', '.join(sorted(self._values))}")


def invalid(message: str) -> RpcError:
    return RpcError(INVALID_PARAMS, ErrorName.INVALID, message)


def pose_values(pose: Pose2D | None) -> dict[str, float] | None:
    """A pose as it goes over the socket: metres and radians."""
    return None if pose is None else {"x": round(pose.x, 4), "y": round(pose.y, 4), "yaw": round(pose.yaw, 5)}
