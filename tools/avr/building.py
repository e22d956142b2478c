"""Compiles the firmware for the AVR and the simulator's shim for this machine, once for each state of their sources."""

from __future__ import annotations

import fcntl
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
SOURCES = _ROOT / "firmware_bridge" / "firmware"
SHIM_SOURCES = Path(__file__).with_name("shim")
_CACHE = _ROOT / "out" / "avr"
_SHIM_FLAGS = ("-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
_COMPILE_LIMIT = 120.0  # s; it takes two on an idle machine

# What each thing is made with: the file that shows it is there, and the Debian package that brings it.
_FIRMWARE_NEEDS = (("make", "make"), ("avr-gcc", "gcc-avr"), ("avr-objcopy", "binutils-avr"))
_SHIM_NEEDS = (("cc", "gcc"),)
_HEADER, _HEADER_PACKAGES = Path("/usr/include/simavr/sim_avr.h"), ("libsimavr-dev", "libelf-dev")
_AVR_LIBC = Path("/usr/lib/avr/include/avr/io.h")


class ToolsMissing(RuntimeError):
    """Something to compile with is not installed; the text names the packages."""


class BuildError(RuntimeError):
    """The compiler refused; the text is what it said."""


@cache
def firmware(board: str, sources: Path = SOURCES) -> bytes:
    """The flash image of `board` ("uno" or "mega"), compiled if need be. ToolsMissing, BuildError."""
    _demand(missing_for_firmware())
    folder = _CACHE / "firmware" if sources == SOURCES else sources / "build"
    path = folder / f"{board}.hex"
    with _only_one(folder):
        _run(["make", "--no-print-directory", "-C", str(sources), f"BUILD={folder}", str(path)])
        return image(path.read_text(encoding="ascii"))


@cache
def shim() -> Path:
    """The shim as a shared library, compiled if need be. ToolsMissing, BuildError."""
    _demand(missing_for_shim())
    path = _CACHE / "shim.so"
    sources = [str(file) for file in sorted(SHIM_SOURCES.glob("*.c"))]
    with _only_one(_CACHE):
        if not path.exists() or path.stat().st_mtime < max(file.stat().st_mtime for file in SHIM_SOURCES.iterdir()):
            fresh = path.with_suffix(".part")  # renamed when whole: another process may have the old one loaded
            _run(["cc", *_SHIM_FLAGS, "-o", str(fresh), *sources, "-lsimavr", "-lm"])
            fresh.replace(path)
    return path


def missing() -> list[str]:
    """Debian packages without which the firmware can't be run here."""
    return missing_for_firmware() + missing_for_shim()


def missing_for_firmware() -> list[str]:
    """Debian packages without which the firmware can't be compiled."""
    return _without(_FIRMWARE_NEEDS) + ([] if _AVR_LIBC.exists() else ["avr-libc"])


def missing_for_shim() -> list[str]:
    """Debian packages without which the simulator can't be compiled."""
    return _without(_SHIM_NEEDS) + ([] if _HEADER.exists() else list(_HEADER_PACKAGES))


def image(text: str) -> bytes:
    """The bytes that an Intel HEX file puts into flash, from address 0; gaps read as erased. ValueError."""
    flash = bytearray()
    base = 0
    for number, line in enumerate(text.split(), 1):
        record = bytes.fromhex(line.removeprefix(":"))
        if sum(record) % 256 != 0:
            raise ValueError(f"line {number} of the HEX file fails its checksum")
        address, kind, data = base + int.from_bytes(record[1:3], "big"), record[3], record[4:-1]
        if kind == 0:
            flash.extend(b"\xff" * (address + len(data) - len(flash)))
            flash[address : address + len(data)] = data
        elif kind in {2, 4}:
            base = int.from_bytes(data, "big") << (4 if kind == 2 else 16)
    return bytes(flash)


def _without(needs: Iterable[tuple[str, str]]) -> list[str]:
    return [package for program, package in needs if shutil.which(program) is None]


def _demand(packages: list[str]) -> None:
    if packages:
        raise ToolsMissing(f"the firmware can't be run here: apt-get install {' '.join(packages)}")


@contextmanager
def _only_one(folder: Path) -> Iterator[None]:
    """Two test runs at once must not compile into each other's files."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=_COMPILE_LIMIT, check=False)
    if done.returncode != 0:
        raise BuildError(f"{' '.join(command)}:\n{done.stdout}{done.stderr}")
