"""The real-time simulated robot as a program: driven over its pty, seen over HTTP, ended by a signal."""

from __future__ import annotations

import http.client
import json
import math
import os
import signal
import subprocess
import sys
import time
import tty
from pathlib import Path

import cv2
import numpy as np
import pytest

from firmware_bridge.bases import make_driver
from firmware_bridge.events import Telemetry
from tools.avr import building
from tools.sim.emulators import BODIES, driver_of

ROOT = Path(__file__).resolve().parents[2]


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tools.sim.server", "--world", "tools.sim.ceilings:plain", *arguments]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ask(address: str, method: str, path: str, body: str = "") -> dict[str, object]:
    connection = http.client.HTTPConnection(address, timeout=5.0)
    connection.request(method, path, body)
    reply = json.loads(connection.getresponse().read())
    connection.close()
    return reply


def drive(line: int, seconds: float, base: str = "omnibot") -> Telemetry:
    """Hands shaken and a moment stood, both wheels at 4 rad/s for so long; returns the last telemetry."""
    driver = make_driver(driver_of(base), BODIES[base].ticks_per_rev, 10.0)
    go, end = math.inf, time.monotonic() + 10.0
    last = None
    while (now := time.monotonic()) < end:
        try:
            data = os.read(line, 4096)
        except BlockingIOError:
            data = b""
        for event in [*driver.receive(data, now), *driver.poll(now)]:
            if isinstance(event, Telemetry):
                go, end = (now + 0.3, now + 0.3 + seconds) if last is None else (go, end)
                last = event
        driver.drive(*((4.0, 4.0) if now > go else (0.0, 0.0)), now)
        os.write(line, driver.data_to_send())
        time.sleep(0.01)
    assert last is not None, "no telemetry"
    return last


def first_picture(address: str) -> np.ndarray:
    connection = http.client.HTTPConnection(address, timeout=5.0)
    connection.request("GET", "/stream")
    stream = connection.getresponse()
    head = [stream.readline() for _ in range(4)]
    length = int(head[2].split(b":")[1])
    picture = cv2.imdecode(np.frombuffer(stream.read(length), np.uint8), cv2.IMREAD_COLOR)
    connection.close()
    return picture


def test_robot_drives_is_seen_is_carried_and_ends_cleanly(tmp_path):
    link, truth = tmp_path / "base", tmp_path / "truth.jsonl"
    process = start("--pose=-1,0,0", "--link", str(link), "--truth", str(truth))
    try:
        ready = json.loads(process.stdout.readline())
        assert os.readlink(link) == ready["port"]
        address = ready["camera"].removeprefix("http://").removesuffix("/stream")
        line = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(line)
        telemetry = drive(line, 1.5)
        os.close(line)
        moved = float(ask(address, "GET", "/truth")["x"]) + 1.0
        assert moved > 0.07
        # Straight ahead: 1440 ticks to the turn of a wheel of 35 mm, each wheel of its own size within a few percent.
        assert telemetry.left_ticks * 2 * np.pi * 0.035 / 1440 == pytest.approx(moved, abs=0.05)
        assert first_picture(address).shape == (480, 640, 3)
        assert ask(address, "POST", "/teleport", '{"x": 0.5, "y": -1, "yaw": 2}')["y"] == pytest.approx(-1, abs=0.1)
        assert "no room" in str(ask(address, "POST", "/teleport", '{"x": 5, "y": 0, "yaw": 0}')["error"])
        assert "expected" in str(ask(address, "POST", "/teleport", '{"x": 5}')["error"])
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0
    finally:
        process.kill()
        _, errors = process.communicate()
    assert errors == ""
    assert not link.is_symlink()
    poses = [json.loads(text) for text in truth.read_text().splitlines()]
    assert poses[0]["x"] == pytest.approx(-1.0)
    assert np.all(np.diff([pose["stamp"] for pose in poses]) > 0.05)


@pytest.mark.parametrize(
    "base",
    ["create2", *(pytest.param(base, marks=pytest.mark.slow) for base in ("arduino_bridge", "omnibot-avr"))],
)
def test_other_bases_are_driven_through_their_own_drivers(base, tmp_path):
    if base == "omnibot-avr" and building.missing():
        pytest.skip(f"not installed: {' '.join(building.missing())}")
    process = start("--pose=-1,0,0", "--base", base)
    try:
        ready = json.loads(process.stdout.readline())
        line = os.open(ready["port"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(line)
        telemetry = drive(line, 1.5, base)
        moved = float(ask(ready["camera"].removeprefix("http://").removesuffix("/stream"), "GET", "/truth")["x"]) + 1.0
        os.close(line)
    finally:
        process.terminate()
        _, errors = process.communicate()
    assert errors == ""
    body = BODIES[base]
    assert moved > 0.07
    assert telemetry.left_ticks * body.metres_per_tick == pytest.approx(moved, abs=0.05)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--pose=3,0,0"], 1, "no room for a robot of radius 0.17 m at x=3.000"),
        (["--base=segway"], 2, "invalid choice: 'segway'"),
        (["--pose=1,2"], 2, "'1,2': expected X,Y,YAW in metres and radians"),
        (["--truth=/nowhere/at/all"], 1, "No such file or directory: '/nowhere/at/all'"),
    ],
)
def test_what_is_wrong_is_said(arguments, code, message):
    process = start(*arguments)
    out, errors = process.communicate(timeout=20.0)
    assert (process.returncode, out) == (code, "")
    assert message in errors
    assert "Traceback" not in errors
