"""The daemon and the client as processes, against a real pty and a real MJPEG stream."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.timeout(120)
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


class Robot:
    """A simulated robot, a configuration for it, and whatever daemon runs on that."""

    def __init__(self, where: dict[str, Any], directory: Path) -> None:
        self._truth = where["camera"].rsplit("/", 1)[0] + "/truth"
        self.directory = directory
        self.socket = directory / "control.sock"
        self.state = directory / "state"
        self.config = directory / "omnibotd.yaml"
        self.config.write_text(
            f"camera: {{source: '{where['camera']}'}}\n"
            f"base: {{driver: omnibot, port: '{where['port']}'}}\n"
            f"storage: {{directory: {self.state}}}\n"
            f"control: {{socket: {self.socket}, group: }}\n"
        )

    def x(self) -> float:
        with urllib.request.urlopen(self._truth, timeout=5) as answer:
            return float(json.load(answer)["x"])

    def ctl(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "omnibotd.cli", "--socket", str(self.socket), *words]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=ENVIRONMENT)

    def status(self) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(self.ctl("--json", "status").stdout)
        return answer

    def until(self, good: Callable[[dict[str, Any]], Any], limit: float = 20.0) -> dict[str, Any]:
        end = time.monotonic() + limit
        while time.monotonic() < end:
            if (status := self.status())["ok"] and good(status):
                return status
            time.sleep(0.2)
        raise AssertionError(f"not so after {limit} s: {status}")

    @contextmanager
    def daemon(self, notify: Path | None = None) -> Iterator[subprocess.Popen[str]]:
        environment = {**ENVIRONMENT, **({"NOTIFY_SOCKET": str(notify), "WATCHDOG_USEC": "1000000"} if notify else {})}
        command = [sys.executable, "-m", "omnibotd.daemon", "--config", str(self.config)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as child:
            try:
                self.until(lambda status: status["base"]["connected"] and status["camera"]["ok"])
                yield child
            finally:
                child.kill()


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    command = [sys.executable, "-m", "tools.sim.server", "--world", "tools.sim.ceilings:plain", "--fps", "10"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT) as simulator:
        assert simulator.stdout is not None
        try:
            yield Robot(json.loads(simulator.stdout.readline()), tmp_path)
        finally:
            simulator.terminate()


def test_a_wrong_configuration_ends_with_2_and_says_where(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text("camera:\n  source: /dev/video0\n  fsp: 15\nbase: {driver: omnibot, port: /dev/ttyUSB0}\n")
    command = [sys.executable, "-m", "omnibotd.daemon", "--config", str(config)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert ended.returncode == 2
    assert f"{config}:3: camera.fsp" in ended.stderr
    assert "fps" in ended.stderr.split("camera.fsp", 1)[1]


def test_check_says_what_would_be_opened_and_opens_nothing(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text("camera: {source: /dev/video7}\nbase: {driver: omnibot, port: /dev/ttyUSB3}\n")
    command = [sys.executable, "-m", "omnibotd.daemon", "--check", "--config", str(config)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert ended.returncode == 0
    assert "/dev/video7" in ended.stdout
    assert "/dev/ttyUSB3" in ended.stdout


def test_systemd_hears_ready_watchdog_and_stopping_and_sigterm_stops_the_wheels(robot: Robot, tmp_path: Path) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
        notify.bind(str(path))
        notify.settimeout(5)
        with robot.daemon(path) as daemon:
            driving = subprocess.Popen(
                [sys.executable, "-m", "omnibotd.cli", "--socket", str(robot.socket), "drive", "0.2", "0"]
            )
            before = robot.x()
            time.sleep(2.0)
            assert robot.x() > before + 0.1
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(10) == 0
            driving.wait(10)
            time.sleep(0.5)
            stood = robot.x()
            time.sleep(0.5)
            assert robot.x() == pytest.approx(stood, abs=1e-3)
        heard = b""
        notify.setblocking(False)
        with pytest.raises(BlockingIOError):
            while True:
                heard += notify.recv(4096) + b"\n"
    assert all(word in heard for word in (b"READY=1", b"WATCHDOG=1", b"STOPPING=1", b"camera and base answer"))
    assert not robot.socket.exists()


def test_a_client_that_drives_and_is_killed_stops_the_robot(robot: Robot) -> None:
    with robot.daemon():
        command = [sys.executable, "-m", "omnibotd.cli", "--socket", str(robot.socket), "drive", "0.2", "0"]
        with subprocess.Popen(command) as client:
            time.sleep(2.0)
            client.kill()
        time.sleep(0.6)
        stood = robot.x()
        assert robot.status()["state"] == "IDLE"
        time.sleep(0.5)
        assert robot.x() == pytest.approx(stood, abs=1e-3)


def test_power_cut_while_recording_loses_at_most_the_last_second(robot: Robot) -> None:
    with robot.daemon() as daemon:
        assert robot.ctl("record", "start", "home").returncode == 0
        for turn in ("0.5", "-0.5", "0.5"):
            robot.ctl("drive", "0.25", turn, "--for", "4")
        recorded = robot.status()["recording"]["frames"]
        daemon.send_signal(signal.SIGKILL)
        daemon.wait(5)
    with robot.daemon():
        trained = robot.ctl("--json", "train", "home")
        assert trained.returncode == 0, trained.stdout
        assert json.loads(robot.ctl("--json", "map", "info", "home").stdout)["nodes"] > 15
        statistics = json.loads(robot.ctl("--json", "map", "info").stdout)["statistics"]
        assert statistics["samples"] >= recorded - 8  # 5 a second, and what was on its way
        png = robot.directory / "map.png"
        assert robot.ctl("map", "plot", "-o", str(png)).returncode == 0
        assert png.read_bytes().startswith(b"\x89PNG")
        assert robot.ctl("map", "verify").returncode == 0


def test_a_corrupt_map_is_refused_with_its_name_and_left_alone(robot: Robot) -> None:
    robot.state.mkdir()
    (robot.state / "home.omap").write_bytes(b"not a map at all" * 100)
    (robot.state / "active").write_text("home\n")
    with robot.daemon() as daemon:
        refused = robot.ctl("map", "use", "home")
        assert refused.returncode == 1
        assert "home.omap" in refused.stderr
        assert robot.status()["map"] is None
        assert robot.ctl("goto", "desk").returncode == 1
        daemon.send_signal(signal.SIGTERM)
        assert daemon.stderr is not None
        assert "home.omap" in daemon.stderr.read()
    assert (robot.state / "home.omap").read_bytes() == b"not a map at all" * 100


def test_no_daemon_is_exit_3_and_wrong_usage_is_2(tmp_path: Path) -> None:
    for words, code in ((["status"], 3), (["drive", "fast"], 2), (["fly"], 2)):
        command = [sys.executable, "-m", "omnibotd.cli", "--socket", str(tmp_path / "none.sock"), *words]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
        assert ended.returncode == code, ended.stderr
        assert ended.stderr.strip()
