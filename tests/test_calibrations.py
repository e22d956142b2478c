"""Calibrations on disk: what replaces the configuration's values, what is ignored and why, what is never lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from omnibotd import calibrations
from omnibotd.calibrations import CalibrationError, Calibrations, apply, file_of, write
from omnibotd.config import BaseConfig, CameraConfig, Config

LENS = {
    "image_width": 640,
    "image_height": 480,
    "distortion_model": "equidistant",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [143.0, 0.0, 318.0, 0.0, 143.5, 241.0, 0.0, 0.0, 1.0]},
    "distortion_coefficients": {"rows": 1, "cols": 4, "data": [0.01, 0.0, 0.0, 0.0]},
    "field_of_view_deg": 185.5,
}
SPIN = {"centre": [318.5, 241.25], "tilt": [0.01, -0.02]}
BASE = {"wheel_radius": 0.0362, "wheel_separation": 0.231, "wheel_ratio": 1.002}
GOOD = {"camera": LENS, "spin": SPIN, "base": BASE}
CONFIG = Config(
    camera=CameraConfig(source="/dev/video0"),
    base=BaseConfig(driver="omnibot", port="/dev/ttyUSB0", wheel_radius=0.035),
)


def stored(directory: Path, name: str, config: Config = CONFIG, **changes: Any) -> Path:
    return write(directory, name, {"residual": "0.31 px", "data": "a test", **GOOD[name], **changes}, config)


def test_without_any_the_configuration_holds(tmp_path: Path) -> None:
    assert apply(CONFIG, tmp_path) == (CONFIG, ())


def test_each_stands_in_for_the_values_it_measured(tmp_path: Path) -> None:
    path = stored(tmp_path, "camera")
    stored(tmp_path, "base")
    lens = yaml.safe_load(path.read_text("utf-8"))["date"]
    write(tmp_path, "spin", {"residual": "0.1 px", **SPIN}, CONFIG, lens)
    config, found = apply(CONFIG, tmp_path)
    assert [(s.name, s.in_use, s.reason) for s in found] == [(name, True, "") for name in ("camera", "spin", "base")]
    assert (config.camera.calibration, config.camera.fov_deg) == (path, 185.5)
    assert (config.camera.centre, config.camera.tilt) == ((318.5, 241.25), (0.01, -0.02))
    assert {name: getattr(config.base, name) for name in BASE} == BASE
    assert (config.camera.source, config.base.port, config.docking) == ("/dev/video0", "/dev/ttyUSB0", CONFIG.docking)
    assert [s.residual for s in found] == ["0.31 px", "0.1 px", "0.31 px"]


def camera(**changes: Any) -> Config:
    return replace(CONFIG, camera=replace(CONFIG.camera, **changes))


def base(**changes: Any) -> Config:
    return replace(CONFIG, base=replace(CONFIG.base, **changes))


@pytest.mark.parametrize(
    ("name", "now", "key"),
    [
        ("camera", camera(calibration=Path("/etc/lens.yaml")), "camera.calibration"),
        ("camera", camera(width=320), "camera.width"),
        ("spin", camera(tilt=(0.0, 0.01)), "camera.tilt"),
        ("spin", camera(centre=(300.0, 240.0)), "camera.centre"),
        ("base", base(wheel_radius=0.04), "base.wheel_radius"),
        ("base", base(ticks_per_rev=1200.0), "base.ticks_per_rev"),
        ("base", base(driver="create2"), "base.driver"),
    ],
)
def test_where_the_configuration_says_otherwise_by_now_that_holds(
    tmp_path: Path, name: str, now: Config, key: str
) -> None:
    stored(tmp_path, name)
    config, (found,) = apply(now, tmp_path)
    assert config == now
    assert not found.in_use
    assert key in found.reason
    assert f"calibrate {name}" in found.reason


def test_other_values_may_change(tmp_path: Path) -> None:
    for name in ("base", "camera"):
        stored(tmp_path, name)
    now = replace(camera(source="http://camera/", mount_yaw=1.0), base=base(port="/dev/ttyACM1").base)
    assert all(s.in_use for s in apply(now, tmp_path)[1])


def test_a_spin_holds_for_the_lens_it_was_measured_with(tmp_path: Path) -> None:
    stored(tmp_path, "spin")
    stored(tmp_path, "camera")
    config, (lens, spin) = apply(CONFIG, tmp_path)
    assert (lens.in_use, spin.in_use) == (True, False)
    assert "another calibration of the camera" in spin.reason
    assert config.camera.tilt == (0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("spin", {"tilt": [3.0, 0.0]}),
        ("spin", {"tilt": [float("nan"), 0.0]}),
        ("spin", {"centre": [1.0]}),
        ("spin", {"centre": None}),
        ("base", {"wheel_ratio": 2.0}),
        ("base", {"wheel_radius": "35 mm"}),
        ("base", {"wheel_radius": True}),
        ("camera", {"camera_matrix": {"data": [1.0]}}),
        ("camera", {"image_width": None}),
        ("camera", {"field_of_view_deg": 3.0}),
    ],
)
def test_what_can_not_be_is_ignored(tmp_path: Path, name: str, changes: dict[str, Any]) -> None:
    stored(tmp_path, name, **changes)
    config, (found,) = apply(CONFIG, tmp_path)
    assert config == CONFIG
    assert "delete the file" in found.reason


@pytest.mark.parametrize(
    "text", ["", "[1, 2]", "centre: [", "\x00", "date: 2024-99-99", "a: 1", "!!python/object:os.system x"]
)
@pytest.mark.parametrize("name", ["camera", "spin", "base"])
def test_a_damaged_file_stops_no_start(tmp_path: Path, name: str, text: str) -> None:
    path = file_of(tmp_path, name)
    path.parent.mkdir()
    path.write_text(text)
    config, (found,) = apply(CONFIG, tmp_path)
    assert config == CONFIG
    assert found.reason


def test_a_file_tells_a_person_what_when_and_under_what(tmp_path: Path) -> None:
    path = stored(tmp_path, "base")
    assert path == tmp_path / "calibration" / "base.yaml"
    text = path.read_text("utf-8")
    assert text.startswith("# Written by `omnibotctl calibrate base`")
    content = yaml.safe_load(text)
    assert {"date", "residual", "data", "configured", *BASE} == set(content)
    assert content["configured"]["base.wheel_radius"] == 0.035


def test_the_result_before_is_kept(tmp_path: Path) -> None:
    stored(tmp_path, "base")
    path = stored(tmp_path, "base", wheel_radius=0.0371)
    assert yaml.safe_load(path.read_text())["wheel_radius"] == 0.0371
    assert yaml.safe_load(path.with_name("base.yaml.old").read_text())["wheel_radius"] == 0.0362
    assert {file.name for file in path.parent.iterdir()} == {"base.yaml", "base.yaml.old"}


def test_a_disk_that_takes_nothing_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = stored(tmp_path, "base")
    before = path.read_bytes()

    def full(*arguments: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(calibrations.os, "fsync", full)
    with pytest.raises(CalibrationError, match=r"No space left.*stays"):
        stored(tmp_path, "base", wheel_radius=0.0371)
    assert path.read_bytes() == before


def damaged(path: Path) -> None:
    path.write_text("nonsense")


def gone(path: Path) -> None:
    path.unlink()


@pytest.mark.parametrize("happened", [damaged, gone])
def test_status_tells_what_holds_since_the_start_and_what_waits(
    tmp_path: Path, happened: Callable[[Path], None]
) -> None:
    path = stored(tmp_path, "base")
    config, found = apply(CONFIG, tmp_path)
    kept = Calibrations(CONFIG, tmp_path, found)
    happened(path)  # what was read at the start is in use
    (told,) = kept.status()
    assert (told["name"], told["in_use"], told["residual"]) == ("base", True, "0.31 px")
    kept.keep("spin", {"residual": "0.12 px", **SPIN})
    _, waiting = kept.status()
    assert (waiting["name"], waiting["in_use"], waiting["residual"]) == ("spin", False, "0.12 px")
    assert "next start" in waiting["reason"]
    assert config.base.wheel_radius == 0.0362


def test_a_spin_kept_while_a_lens_is_in_force_holds_with_that_lens(tmp_path: Path) -> None:
    stored(tmp_path, "camera")
    _, found = apply(CONFIG, tmp_path)
    Calibrations(CONFIG, tmp_path, found).keep("spin", {"residual": "0.1 px", **SPIN})
    config, after = apply(CONFIG, tmp_path)
    assert all(s.in_use for s in after)
    assert config.camera.centre == (318.5, 241.25)
