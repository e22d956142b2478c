"""What `omnibotctl doctor` can find out without the daemon: from the system, the configuration and the devices.

Needs neither numpy nor OpenCV, though YAML: to be imported by this verb only, for the client starts in a blink.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import omnibotd
from omnibotd import device_checks, findings
from omnibotd.config import Config, ConfigError, load
from omnibotd.findings import Finding, ok, unknown, warning, wrong

SERVICE = "omnibotd"
WATCHED = 1.0  # s over which the processor is watched
PATIENCE = 2.0  # s for a command of the system to answer

Busy = tuple[float, float]  # jiffies worked and in all, of all processors


# ---- the machine


def machine(proc: Path = Path("/proc"), daemon_share: float | None = None) -> list[Finding]:
    """Clock, processor and memory of this PC; takes a second."""
    return [clock(), *processor(proc, daemon_share), *memory(proc)]


def clock() -> Finding:
    built = Path(omnibotd.__file__).stat().st_mtime
    return findings.clock(time.time(), built, _synchronised(_told("timedatectl", "show", "-p", "NTPSynchronized")))


def _synchronised(told: str | None) -> bool | None:
    return None if told is None or "=" not in told else told.strip().endswith("=yes")


def processor(proc: Path, daemon_share: float | None) -> Iterator[Finding]:
    before = _busy(proc)
    time.sleep(WATCHED if before else 0.0)
    after = _busy(proc)
    if before is None or after is None or after[1] <= before[1]:
        yield unknown("processor", "the kernel does not tell")
        return
    yield findings.processor((after[0] - before[0]) / (after[1] - before[1]), daemon_share)


def _busy(proc: Path) -> Busy | None:
    """From the first line of /proc/stat: user nice system idle iowait irq softirq steal."""
    try:
        jiffies = [float(word) for word in (proc / "stat").read_text().split("\n", 1)[0].split()[1:9]]
    except (OSError, ValueError):
        return None
    return (sum(jiffies) - sum(jiffies[3:5]), sum(jiffies)) if len(jiffies) == 8 else None


def memory(proc: Path) -> Iterator[Finding]:
    try:
        lines = dict(line.split(":", 1) for line in (proc / "meminfo").read_text().splitlines())
        yield findings.memory(1024.0 * float(lines["MemAvailable"].split()[0]))
    except (OSError, ValueError, KeyError):
        yield unknown("memory", "the kernel does not tell")


def _told(*command: str) -> str | None:
    """What a command of the system says; None where there is none, or it fails."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


# ---- without the daemon


def without_daemon(config_file: Path, reason: str) -> list[Finding]:
    """Why it may be that no daemon answers, and how its devices do."""
    found = [service(reason), *machine()]
    try:
        config = load(config_file)
    except ConfigError as error:
        return [
            *found,
            wrong("configuration", str(error), f"mend {config_file}; omnibotd --check says whether it is good"),
        ]
    return [
        *found,
        ok("configuration", f"{config_file} is good"),
        *device_checks.camera(config.camera),
        *device_checks.serial_port(config.base.port),
        storage(config.storage.directory),
        *calibrations(config),
    ]


def service(reason: str) -> Finding:
    told = _told("systemctl", "show", SERVICE, "-p", "LoadState,ActiveState,Result,NRestarts,StatusText")
    facts = dict(line.split("=", 1) for line in (told or "").splitlines() if "=" in line)
    state = facts.get("ActiveState", "")
    if not facts or facts.get("LoadState") == "not-found":
        return wrong("daemon", reason, f"start it: {SERVICE} --config FILE, or install its systemd unit")
    if state == "active":
        about = facts.get("StatusText") or "no status"
        return wrong("daemon", f"runs ({about}) but does not answer: {reason}", f"systemctl restart {SERVICE}")
    if state in ("failed", "activating"):
        restarts = f", restarted {facts.get('NRestarts', '?')} times"
        return wrong("daemon", f"{state} ({facts.get('Result')}{restarts})", f"journalctl -u {SERVICE} -n 30 says why")
    return wrong("daemon", f"is {state or 'not running'}", f"systemctl enable --now {SERVICE}")


def storage(folder: Path) -> Finding:
    try:
        return findings.disk(float(shutil.disk_usage(folder).free), str(folder))
    except OSError as error:
        remedy = f"install -d -o omnibotd -g omnibot -m 750 {folder}, or see storage.directory in the configuration"
        return wrong("disk", f"{folder}: {error.strerror}", remedy)


def calibrations(config: Config) -> Iterator[Finding]:
    """Whether they are there; whether they still hold is the daemon's to say."""
    folder = config.storage.directory / "calibration"
    if not os.access(config.storage.directory, os.R_OK | os.X_OK):
        yield unknown("calibration", f"{folder} can't be read by this user")
        return
    for name in ("camera", "spin", "base"):
        if (folder / f"{name}.yaml").exists():
            yield ok(f"calibration {name}", f"{folder / name}.yaml")
        elif name == "camera" and config.camera.calibration is not None:
            yield _lens_file(config.camera.calibration)
        else:
            yield warning(f"calibration {name}", "none", f"with the daemon running: omnibotctl calibrate {name}")


def _lens_file(path: Path) -> Finding:
    if path.is_file():
        return ok("calibration camera", str(path))
    return wrong("calibration camera", f"{path} is not there", "see camera.calibration in the configuration")
