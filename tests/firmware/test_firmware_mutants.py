"""Each line that keeps the robot safe, taken away: the tests must notice."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tools.avr import building

HERE = Path(__file__).parent
WITNESSES = [str(HERE / f"test_firmware_{name}.py") for name in ("session", "watchdog", "config", "wheels", "vectors")]

# What is taken away: file, the line as it is, and as it would be.
MUTANTS = {
    "no host watchdog": ("motor.c", "if (permission > 0 && --permission == 0)", "if (0)"),
    "a shorter host watchdog": ("motor.h", "PERMISSION_MS 250", "PERMISSION_MS 235"),
    "off does nothing": ("motor.c", "        permission = 0;\n        outputs_off();", "        permission = 0;"),
    "drives without permission": (
        "motor.c",
        "        if (permission > 0)\n            outputs_drive(pwm);",
        "        outputs_drive(pwm);",
    ),
    "no hardware watchdog": ("main.c", "    wdt_enable(HANG_LIMIT);\n", ""),
    "the interrupt feeds the hardware watchdog": (
        "clock.c",
        "    milliseconds++;\n",
        '    milliseconds++;\n    __asm__ volatile("wdr");\n',
    ),
    "moves without a handshake": ("session.c", "if (!greeted || latched", "if (latched"),
    "the emergency stop does not hold": ("session.c", "if (!greeted || latched", "if (!greeted"),
    "the emergency stop does not latch": ("session.c", "    latched = true;\n", ""),
    "the emergency stop does not stop": ("session.c", "    latched = true;\n    drive_stop();", "    latched = true;"),
    "a greeting releases the emergency stop": ("session.c", "greeted = true;", "greeted = true, latched = false;"),
    "a greeting does not stop": ("session.c", "        drive_forgive();\n", ""),
    "set-points of another boot": ("session.c", "setpoint->boot_nonce != nonce || !newer(seq)", "!newer(seq)"),
    "a release of another boot": (
        "session.c",
        "    if (release->boot_nonce != nonce)\n        return;\n    latched",
        "    (void)release;\n    latched",
    ),
    "set-points in any order": ("session.c", "nonce || !newer(seq))", "nonce || (0 && !newer(seq)))"),
    "repeated set-points": ("session.c", "return ahead != 0 && (", "return ("),
    "old set-points": ("session.c", "(ahead < 128 || !motor_permitted())", "(true)"),
    "late set-points": ("session.c", "!rest && untimely(setpoint->mcu_us)", "0 && untimely(0) && !rest"),
    "set-points later than that": ("session.c", "LATE 250000", "LATE 350000"),
    "set-points from the future": ("session.c", "EARLY 20000", "EARLY 2000000"),
    "other versions are served": ("session.c", "if (hello->version == PROTOCOL_VERSION)", "if (hello->version != 0)"),
    "the same number at each boot": ("nonce.c", "record.boot = last + 1", "record.boot = last * 0 + 1"),
    "one record of the boot's number": ("nonce.c", "oldest = index ^ 1", "oldest = 0"),
    "broken frames": ("framing.c", "if (crc != crc16(body, length - 2))", "if (crc == 0 && length == 0)"),
    "damaged configuration": ("config.c", "record->crc == crc16", "record->crc != 1 + crc16"),
    "configuration while driving": ("session.c", "motor_permitted() || config_storing())", "config_storing())"),
    "set-points while a configuration is stored": ("session.c", "latched || config_storing())", "latched)"),
    "any configuration": ("session.c", "if (!config_acceptable(&configure->config))", "if (0)"),
    "no guard": ("drive.c", "<< side);\n    drive_stop();", "<< side);"),
    "the guard lets go at once": ("drive.c", "    if (tripped)\n        return;\n", ""),
    "no limit of speed": ("wheel.c", "clamp(target, config.max_speed)", "clamp(target, 30000)"),
    "no limit of acceleration": ("wheel.c", "most > 0 ? most : 1)", "most > 0 ? 100000000 : 1)"),
    "the wheel's sign is lost": ("motor.c", "pwm > 0 ? forward : pwm < 0 ? backward : 0", "pwm != 0 ? forward : 0"),
}  # fmt: skip


def run_tests(sources: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *WITNESSES]
    environment = {**os.environ, "FIRMWARE_SOURCES": str(sources)}
    root = Path(building.__file__).parents[2]
    return subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False, timeout=500)


def copy_sources(folder: Path) -> Path:
    return shutil.copytree(building.SOURCES, folder / "firmware", ignore=shutil.ignore_patterns("build"))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_is_noticed(tmp_path: Path, name: str) -> None:
    file, line, changed = MUTANTS[name]
    sources = copy_sources(tmp_path)
    text = (sources / file).read_text(encoding="utf-8")
    assert text.count(line) == 1, f"{file} has no longer one line {line!r}"
    (sources / file).write_text(text.replace(line, changed), encoding="utf-8")
    for board in ("uno", "mega"):
        building.firmware(board, sources)  # it must be a program, else nothing is shown
    done = run_tests(sources)
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout[-2000:]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_without_a_change_all_is_well(tmp_path: Path) -> None:
    done = run_tests(copy_sources(tmp_path))
    assert done.returncode == pytest.ExitCode.OK, done.stdout[-2000:]
