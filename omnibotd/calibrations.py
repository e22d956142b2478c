"""Results of `calibrate`, as files of the store: `calibration/camera.yaml`, `spin.yaml`, `base.yaml`.

A calibration holds for the configuration it was measured with, which stands in its file. At the start of the daemon it
replaces the configuration's values; where they were changed since, it is ignored, and that is said. Blocking.
"""

from __future__ import annotations

import dataclasses
import logging
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from omnibotd.config import BaseConfig, CameraConfig, Config
from omnibotd.core.errors import CoreError
from omnibotd.io.camera import load_calibration

log = logging.getLogger(__name__)

NAMES = ("camera", "spin", "base")
NEXT_START = "takes effect at the next start of omnibotd"
_HEADER = "# Written by `omnibotctl calibrate {name}`; delete the file to go back to the configuration's own values.\n"
# What a calibration depends on and stands in for, by section of the configuration.
_CONFIGURED = {
    "camera": ("camera", ("calibration", "fov_deg", "width", "height")),
    "spin": ("camera", ("tilt", "centre", "calibration", "fov_deg", "radius", "width", "height")),
    "base": ("base", ("driver", "wheel_radius", "wheel_separation", "wheel_ratio", "ticks_per_rev")),
}


class CalibrationError(CoreError):
    """A calibration file that can't be used, or written."""


@dataclass(frozen=True, slots=True)
class Stored:
    """A calibration as found at the start: `residual` in words; `reason` says why it is ignored, empty where in use."""

    name: str
    date: str
    residual: str
    reason: str = ""

    @property
    def in_use(self) -> bool:
        return not self.reason


def apply(configured: Config, directory: Path) -> tuple[Config, tuple[Stored, ...]]:
    """The configuration with the calibrations kept in the storage `directory` in place of its values, and what was
    found. What is ignored is logged; a damaged file stops nothing."""
    config = configured
    found: list[Stored] = []
    for name in NAMES:
        path = file_of(directory, name)
        if not path.exists():
            continue
        config, stored = _applied(name, path, config, configured, _lens(found))
        found.append(stored)
        if stored.reason:
            log.warning("calibration %s of %s is ignored: %s", name, stored.date, stored.reason)
        else:
            log.info("calibration %s of %s in use, residual %s", name, stored.date, stored.residual)
    return config, tuple(found)


def file_of(directory: Path, name: str) -> Path:
    return directory / "calibration" / f"{name}.yaml"


def write(directory: Path, name: str, content: Mapping[str, Any], configured: Config, lens: str | None = None) -> Path:
    """Keep a result, the one before as NAME.yaml.old; `lens` is the date of the calibration `camera` in force.

    `content` has what `apply` needs (camera: camera_info; spin: centre, tilt; base: wheel_radius, wheel_separation,
    wheel_ratio), `residual` in words, and whatever else a person wants to know. Raises CalibrationError.
    """
    path = file_of(directory, name)
    date = datetime.now().astimezone().isoformat(timespec="seconds")
    facts = {"date": date, **content, "configured": _conditions(name, configured, lens)}
    new = path.with_name(f".{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with new.open("w", encoding="utf-8") as file:
            file.write(_HEADER.format(name=name))
            yaml.safe_dump(facts, file, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            os.replace(path, path.with_name(f"{path.name}.old"))
        os.replace(new, path)
    except OSError as error:
        raise CalibrationError(f"{path}: {error.strerror or error}; the calibration before stays") from error
    return path


class Calibrations:
    """What is in use since the start, and what was measured since."""

    def __init__(self, configured: Config, directory: Path, stored: tuple[Stored, ...] = ()) -> None:
        self._configured, self._directory, self._stored = configured, directory, stored
        self._measured: dict[str, str] = {}

    def keep(self, name: str, content: Mapping[str, Any]) -> Path:
        """Store a result measured with the configuration and the lens in force. Raises CalibrationError."""
        path = write(self._directory, name, content, self._configured, _lens(self._stored))
        self._measured[name] = str(content.get("residual", ""))
        return path

    def status(self) -> list[dict[str, Any]]:
        """What `status` tells of each."""
        told = [
            {"name": s.name, "date": s.date, "residual": s.residual, "in_use": s.in_use, "reason": s.reason}
            for s in self._stored
        ]
        return told + [
            {"name": name, "date": "now", "residual": residual, "in_use": False, "reason": NEXT_START}
            for name, residual in self._measured.items()
        ]


def _applied(name: str, path: Path, config: Config, configured: Config, lens: str | None) -> tuple[Config, Stored]:
    try:
        content = _read(path)
    except CalibrationError as error:
        return config, Stored(name, "unknown date", "", f"{error}; say calibrate {name} again, or delete the file")
    stored = Stored(name, str(content.get("date", "unknown date")), str(content.get("residual", "unknown")))
    reason = _difference(content.get("configured"), _conditions(name, configured, lens), name)
    if reason is None:
        try:
            return _APPLY[name](config, content, path), stored
        except (CoreError, KeyError, TypeError, ValueError) as error:
            reason = f"{path}: {type(error).__name__} {error}; say calibrate {name} again, or delete the file"
    return config, replace(stored, reason=reason)


def _read(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text("utf-8"))
    except OSError as error:
        raise CalibrationError(f"{path}: can't be read: {error.strerror}") from error
    except (UnicodeDecodeError, yaml.YAMLError, ValueError, RecursionError) as error:
        raise CalibrationError(f"{path}: is no valid YAML") from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: holds no `key: value` lines")
    return content


def _conditions(name: str, configured: Config, lens: str | None) -> dict[str, Any]:
    """The configuration's values under which a calibration holds, as YAML keeps them."""
    section, keys = _CONFIGURED[name]
    values = {f"{section}.{key}": _plain(getattr(getattr(configured, section), key)) for key in keys}
    return {**values, "lens": lens} if name == "spin" else values


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    return list(value) if isinstance(value, tuple) else value


def _difference(then: Any, now: Mapping[str, Any], name: str) -> str | None:
    """Why a calibration measured under `then` does not hold now."""
    if not isinstance(then, dict):
        return f"it does not say which configuration it was measured with; say calibrate {name} again"
    for key, value in now.items():
        if not _same(then.get(key), value):
            what = "another calibration of the camera" if key == "lens" else f"{key} {then.get(key)}, now {value}"
            return f"it was measured with {what}; say calibrate {name} again"
    return None


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (one, other))
    return math.isclose(one, other, rel_tol=1e-9) if numbers else bool(one == other)


def _lens(stored: tuple[Stored, ...] | list[Stored]) -> str | None:
    return next((s.date for s in stored if s.name == "camera" and s.in_use), None)


def _with_lens(config: Config, content: Mapping[str, Any], path: Path) -> Config:
    load_calibration(path)
    fov = _checked(CameraConfig, "fov_deg", content.get("field_of_view_deg", config.camera.fov_deg))
    return replace(config, camera=replace(config.camera, calibration=path, fov_deg=fov))


def _with_axis(config: Config, content: Mapping[str, Any], path: Path) -> Config:
    (u, v), (x, y) = content["centre"], content["tilt"]
    centre = (_checked(CameraConfig, "centre", u), _checked(CameraConfig, "centre", v))
    tilt = (_checked(CameraConfig, "tilt", x), _checked(CameraConfig, "tilt", y))
    return replace(config, camera=replace(config.camera, centre=centre, tilt=tilt))


def _with_wheels(config: Config, content: Mapping[str, Any], path: Path) -> Config:
    base = replace(
        config.base,
        wheel_radius=_checked(BaseConfig, "wheel_radius", content["wheel_radius"]),
        wheel_separation=_checked(BaseConfig, "wheel_separation", content["wheel_separation"]),
        wheel_ratio=_checked(BaseConfig, "wheel_ratio", content["wheel_ratio"]),
    )
    return replace(config, base=base)


_APPLY: Mapping[str, Callable[[Config, Mapping[str, Any], Path], Config]] = {
    "camera": _with_lens,
    "spin": _with_axis,
    "base": _with_wheels,
}


def _checked(section: type[Any], key: str, value: Any) -> float:
    """A number in the range of the option that it replaces. ValueError."""
    rule = next(field.metadata["rule"] for field in dataclasses.fields(section) if field.name == key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not rule.low <= value <= rule.high:
        raise ValueError(f"{key}: {value!r}, expected a number {rule.bounds()}")
    return float(value)
