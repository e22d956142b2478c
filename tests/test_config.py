import dataclasses
import typing
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_bridge.bases import DRIVERS
from omnibotd.config import BASE_DRIVERS, Config, ConfigError, load
from omnibotd.config_reader import reference

SHIPPED = Path(__file__).resolve().parents[1] / "config"
MINIMAL = {"camera": {"source": "/dev/video0"}, "base": {"driver": "omnibot", "port": "/dev/ttyUSB0"}}


def write(folder: Path, text: str) -> Path:
    path = folder / "robot.yaml"
    path.write_text(text, "utf-8")
    return path


def with_option(section: str, key: str, value: object) -> str:
    return yaml.safe_dump({**MINIMAL, section: {**MINIMAL.get(section, {}), key: value}})


def problems(folder: Path, text: str) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        load(write(folder, text))
    return caught.value.problems


def options() -> list[tuple[str, str, typing.Any, typing.Any]]:
    """(section, key, type, rule) of every option there is."""
    return [
        (section, item.name, typing.get_type_hints(kind)[item.name], item.metadata["rule"])
        for section, kind in typing.get_type_hints(Config).items()
        for item in dataclasses.fields(kind)
    ]


NUMBERS = [row for row in options() if row[2] in (int, float, float | None)]


def test_three_lines_make_a_working_file_and_the_rest_are_the_documented_defaults(tmp_path):
    config = load(write(tmp_path, yaml.safe_dump(MINIMAL)))
    assert config.camera.source == "/dev/video0"
    assert (config.camera.width, config.camera.height, config.camera.fps, config.camera.fov_deg) == (640, 480, 15, 190)
    assert (config.base.wheel_radius, config.base.wheel_separation, config.base.ticks_per_rev) == (0.035, 0.23, None)
    assert (config.base.max_linear_velocity, config.base.cmd_vel_timeout, config.base.baudrate) == (0.3, 0.5, 115200)
    assert (config.navigation.xy_goal_tolerance, config.docking.max_retries) == (0.05, 3)
    assert (config.storage.directory, config.control.group) == (Path("/var/lib/omnibotd"), "omnibot")
    assert config.control.socket == Path("/run/omnibotd/control.sock")


@pytest.mark.parametrize(
    ("driver", "extra", "found"),
    [
        ("omnibot", {}, (115200, 0.035, 0.23, None, 0.17, 0.3)),
        ("create2", {}, (115200, 0.036, 0.235, None, 0.17, 0.5)),
        ("create2", {"wheel_radius": 0.0362, "max_linear_velocity": 0.3}, (115200, 0.0362, 0.235, None, 0.17, 0.3)),
        ("arduino_bridge", {"ticks_per_rev": 1200}, (57600, 0.035, 0.23, 1200, 0.17, 0.3)),
    ],
)
def test_defaults_are_what_the_driver_s_base_has(tmp_path, driver, extra, found):
    base = {"driver": driver, "port": "/dev/ttyUSB0", **extra}
    config = load(write(tmp_path, yaml.safe_dump({**MINIMAL, "base": base}))).base
    assert found == (
        config.baudrate,
        config.wheel_radius,
        config.wheel_separation,
        config.ticks_per_rev,
        config.robot_radius,
        config.max_linear_velocity,
    )


def test_what_a_base_can_not_tell_has_to_be_configured(tmp_path):
    text = "camera: {source: /dev/video0}\nbase:\n  driver: arduino_bridge\n  port: /dev/ttyUSB0\n"
    assert problems(tmp_path, text) == (
        f"{tmp_path / 'robot.yaml'}:3: base.ticks_per_rev: missing, expected a number from 1 to 1000000: "
        "its board can't tell",
    )


def test_every_driver_has_a_name_that_the_configuration_takes():
    assert set(BASE_DRIVERS) == set(DRIVERS)


def test_values_are_read_as_their_types(tmp_path):
    text = """
camera: {source: /dev/video2, tilt: [0.01, -0.02], centre: [320, 241.5], fps: 10}
base: {driver: omnibot, port: "usb:0403:6001:A1B2", ticks_per_rev: 1440}
docking: {ceiling_height: 2.2}
"""
    config = load(write(tmp_path, text))
    assert config.camera.tilt == (0.01, -0.02)
    assert config.camera.centre == (320.0, 241.5)
    assert (config.camera.fps, type(config.camera.fps)) == (10.0, float)
    assert (config.base.ticks_per_rev, config.docking.ceiling_height) == (1440.0, 2.2)


def test_relative_paths_count_from_the_file(tmp_path):
    text = with_option("camera", "calibration", "lens/camera.yaml")
    assert load(write(tmp_path, text)).camera.calibration == tmp_path / "lens/camera.yaml"
    assert load(write(tmp_path, with_option("camera", "source", "drive1"))).camera.source == str(tmp_path / "drive1")
    stream = "http://10.0.0.7:8080/video"
    assert load(write(tmp_path, with_option("camera", "source", stream))).camera.source == stream
    assert load(write(tmp_path, with_option("storage", "directory", "/data"))).storage.directory == Path("/data")


def test_a_blank_means_none_where_there_may_be_none_and_a_blank_section_its_defaults(tmp_path):
    config = load(write(tmp_path, yaml.safe_dump(MINIMAL) + "control:\n  group:\ndocking:\n"))
    assert config.control.group is None
    assert config.docking.max_retries == 3


@pytest.mark.parametrize(("section", "key", "kind", "rule"), NUMBERS, ids=lambda value: str(value)[:24])
def test_each_number_is_taken_up_to_its_limits_and_not_beyond(tmp_path, section, key, kind, rule):
    for limit, beyond in ((rule.low, rule.low - 1), (rule.high, rule.high + 1)):
        number = int(limit) if kind is int else limit
        config = load(write(tmp_path, with_option(section, key, number)))
        assert getattr(getattr(config, section), key) == limit
        (problem,) = problems(tmp_path, with_option(section, key, beyond))
        assert f"{section}.{key}: found {beyond}" in problem
        assert f"from {rule.low:.7g} to {rule.high:.7g}" in problem


@pytest.mark.parametrize(("section", "key", "kind", "rule"), NUMBERS, ids=lambda value: str(value)[:24])
@pytest.mark.parametrize("value", ["fast", True, [1], {"a": 1}, float("nan"), float("inf")], ids=str)
def test_no_number_takes_anything_else(tmp_path, section, key, kind, rule, value):
    (problem,) = problems(tmp_path, with_option(section, key, value))
    assert f"{section}.{key}: found " in problem
    assert "expected a " in problem


def test_a_fraction_is_no_whole_number(tmp_path):
    (problem,) = problems(tmp_path, with_option("camera", "width", 640.5))
    assert "camera.width: found 640.5, expected a whole number from 160 to 4096 (px)" in problem


@pytest.mark.parametrize("port", ["ttyUSB0", "usb:12:34", "usb:0403", "http://10.0.0.7", "", 3])
def test_a_port_has_one_of_three_forms(tmp_path, port):
    (problem,) = problems(tmp_path, with_option("base", "port", port))
    assert "usb:VID:PID[:SERIAL]" in problem


@pytest.mark.parametrize("port", ["/dev/ttyUSB0", "usb:0403:6001", "usb:2341:0043:75F3", "socket://127.0.0.1:4000"])
def test_ports_of_the_three_forms_are_taken(tmp_path, port):
    assert load(write(tmp_path, with_option("base", "port", port))).base.port == port


@pytest.mark.parametrize("source", ["rtsp://10.0.0.7/live", "https://10.0.0.7/video", "http://", 0, None])
def test_a_source_that_is_none_is_refused(tmp_path, source):
    (problem,) = problems(tmp_path, with_option("camera", "source", source))
    assert "expected a device, an http:// address, a video file or a folder of images" in problem


def test_a_socket_path_must_fit_the_kernels_field_of_108_bytes(tmp_path):
    fits = "/" + "s" * 106
    assert str(load(write(tmp_path, with_option("control", "socket", fits))).control.socket) == fits
    (problem,) = problems(tmp_path, with_option("control", "socket", fits + "s"))
    assert "at most 107 bytes" in problem


def test_every_fault_is_told_at_once_with_its_line(tmp_path):
    text = """camera:
  sorce: /dev/video0
  width: wide
base:
  driver: roomba
  port: /dev/ttyUSB0
  port: /dev/ttyUSB1
  frame_rate: 5
docking: 3
colour: blue
"""
    path = tmp_path / "robot.yaml"
    sections = "camera, base, odometry, navigation, docking, recording, mapping, storage, control"
    assert problems(tmp_path, text) == (
        f"{path}:2: camera.sorce: unknown key; did you mean camera.source?",
        f"{path}:2: camera.source: missing, expected a device, an http:// address, a video file or a folder of images",
        f"{path}:3: camera.width: found the text 'wide', expected a whole number from 160 to 4096 (px)",
        f"{path}:5: base.driver: found the text 'roomba', expected omnibot or create2 or arduino_bridge",
        f"{path}:7: base.port: given twice, first on line 6",
        f"{path}:8: base.frame_rate: unknown key; did you mean recording.frame_rate?",
        f"{path}:9: docking: found 3, expected lines of 'key: value'",
        f"{path}:10: colour: unknown key, expected one of {sections}",
    )


def test_what_is_missing_is_named_in_an_empty_file(tmp_path):
    found = problems(tmp_path, "# nothing yet\n")
    assert [line.split(": ")[1] for line in found] == ["base.driver", "base.port", "camera.source"]


@pytest.mark.parametrize(
    ("text", "line"),
    [("camera:\n  source: [/dev/video0\nbase: x", 3), ("camera: {}\nbase: *nowhere\n", 2), ("a: b: c", 1)],
)
def test_broken_yaml_is_told_with_its_line(tmp_path, text, line):
    (problem,) = problems(tmp_path, text)
    assert problem.startswith(f"{tmp_path / 'robot.yaml'}:{line}: is no valid YAML: ")


def test_other_unreadable_files_are_told_by_name(tmp_path):
    with pytest.raises(ConfigError, match=r"missing\.yaml: can't be read: No such file"):
        load(tmp_path / "missing.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"camera: \xff")
    with pytest.raises(ConfigError, match="is no UTF-8 text"):
        load(tmp_path / "binary.yaml")
    (problem,) = problems(tmp_path, "[" * 5000)
    assert "nested too deeply" in problem


def test_aliases_that_explode_when_expanded_are_refused_quickly(tmp_path):
    rows = ["a0: &a0 [1, 1]", *(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 40))]
    assert any("tilt" in line for line in problems(tmp_path, "\n".join([*rows, "camera: {tilt: *a39}"])))


@settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.one_of(st.text(max_size=60), st.lists(st.sampled_from(
    ["camera:", "  source: ", "base:", "  tilt: [", "&a", "*a", "!!int x", "- ", "? ", "<<: ", "\n", "9" * 5000, ": "]
), max_size=8).map("".join)))  # fmt: skip
def test_no_text_makes_anything_but_a_configuration_or_a_config_error(tmp_path, text):
    path = tmp_path / "robot.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(ConfigError):  # none of these holds the three needed keys
        load(path)


def test_the_shipped_files_load():
    assert load(SHIPPED / "omnibotd.yaml").base.driver == "omnibot"
    simulated = load(SHIPPED / "simulated.yaml")
    assert simulated.camera.source.startswith("http://127.0.0.1:")
    assert simulated.control.group is None
    assert load(SHIPPED / "create2.yaml").base.driver == "create2"
    assert load(SHIPPED / "arduino_bridge.yaml").base.driver == "arduino_bridge"


def test_the_shipped_default_is_the_table_of_options_printed():
    assert (SHIPPED / "omnibotd.yaml").read_text() == reference(Config)


def test_every_option_stands_in_the_shipped_default_with_a_value_that_is_taken(tmp_path):
    text = reference(Config)
    for _, key, _, _ in options():
        text = text.replace(f"  # {key}: ", f"  {key}: ")
    config = load(write(tmp_path, text))
    written = yaml.safe_load(text)
    for section, key, _, _ in options():
        assert key in written[section]
    without = ("calibration", "centre", "radius", "exposure", "white_balance")  # no default: an example stands there
    assert dataclasses.replace(config.camera, **dict.fromkeys(without)) == dataclasses.replace(
        load(SHIPPED / "omnibotd.yaml").camera
    )
