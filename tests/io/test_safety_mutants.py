"""Each line by which the daemon keeps the wheels safe, taken away: the tests must notice.

Those of the firmware stand in tests/firmware/test_firmware_mutants.py.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WITNESSES = {
    "omnibotd/io": ("tests/io/test_stop_guard.py", "tests/io/test_motor_base.py"),
    "firmware_bridge": ("tests/firmware_bridge/test_omnibot.py", "tests/firmware_bridge/test_device.py"),
    "firmware_bridge/bases": (
        "tests/firmware_bridge/test_omnibot.py",
        "tests/firmware_bridge/test_omnibot_stop.py",
        "tests/firmware_bridge/test_create2.py",
        "tests/firmware_bridge/test_create2_joined.py",
        "tests/firmware_bridge/test_arduino_bridge.py",
    ),
}

# What is taken away: folder, file, the line as it is, and as it would be.
GUARD, CHILD = ("omnibotd/io", "stop_guard.py"), ("omnibotd/io", "stop_guard_child.py")
BASE = ("omnibotd/io", "motor_base.py")
HOST, DEVICE = ("firmware_bridge/bases", "omnibot.py"), ("firmware_bridge", "device.py")
MUTANTS = {
    "a guard without ears": (*CHILD, "rolling = beats[-1:] == ROLLING", "rolling = False"),
    "a guard too patient": (*CHILD, "SILENCE = 0.3", "SILENCE = 3.0"),
    "a guard that keeps silent in a hang": (*CHILD, "speak(line, stand)\n", "pass\n"),
    "a guard without last words": (*CHILD, "            break\n", "            return\n"),
    "a guard that dies with its daemon": (*CHILD, "signal.SIG_IGN", "signal.SIG_DFL"),
    "a guard behind the queue": (*CHILD, "termios.tcflush(line, termios.TCOFLUSH)", "pass"),
    "a guard that hears nothing": (*GUARD, "self._heart.send(ROLLING if rolling else STANDING)", "pass"),
    "no guard": (*BASE, "if words is not None and self._start_guard is not None:", "if words is None:"),
    "no beats": (*BASE, "self._guard.beat(rolling=left != 0.0 or right != 0.0)", "pass"),
    "a dead guard": (*BASE, "if self._guard is not None and not self._guard.alive:", "if False:"),
    "no last words": (*BASE, "link.write(words.leave)", "pass"),
    "no stop on the way out": (*BASE, "            self.stop()\n            reading", "            reading"),
    "a stall goes on as before": (*BASE, "            left = right = 0.0\n", "            pass\n"),
    "a stall keeps its link": (*BASE, "raise LinkLost(f\"this program", "print(f\"this program"),
    "a stop of the host does not last": (*HOST, " or self._stop_wanted:", ":"),
    "a stop dies with the base": (*HOST, "wanted:\n            self._ask", "wanted and 0:\n            self._ask"),
    "a stop is said once": (*HOST, "due = True\n        return []", "due = request.tries == 1\n        return []"),
    "deaf to silence": (*HOST, "SILENCE = 0.3", "SILENCE = 3.0"),
    "deaf to a restart": (*HOST, "if report.boot_nonce != self._info.boot_nonce:", "if False:"),
    "kept for the next life": (*HOST, "self._setpoint = None\n        self._request = None", "self._request = None"),
    "set-points repeated": (*HOST, "        self._setpoint = None\n        return data", "        return data"),
    "a clock that stands": (*HOST, "int((now - self._heard_at) * 1e6)", "0"),
    "late set-points": (*DEVICE, "> LATE + EARLY", "> 2**32"),
}  # fmt: skip


def copy_of_the_checkout(folder: Path) -> Path:
    for name in ("omnibotd", "firmware_bridge", "tools", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "pictures"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def run_tests(checkout: Path, witnesses: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *witnesses]
    return subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False, timeout=280)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_is_noticed(tmp_path: Path, name: str) -> None:
    folder, file, line, changed = MUTANTS[name]
    source = copy_of_the_checkout(tmp_path) / folder / file
    text = source.read_text(encoding="utf-8")
    assert text.count(line) == 1, f"{file} has no longer one line {line!r}"
    source.write_text(text.replace(line, changed), encoding="utf-8")
    done = run_tests(tmp_path, WITNESSES[folder])
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout[-2000:]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("folder", WITNESSES)
def test_without_a_change_all_is_well(tmp_path: Path, folder: str) -> None:
    done = run_tests(copy_of_the_checkout(tmp_path), WITNESSES[folder])
    assert done.returncode == pytest.ExitCode.OK, done.stdout[-2000:]
