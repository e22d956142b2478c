"""Builds the Debian package (launcher: tools/package): daemon, client, unit, udev rules, configuration.

What omnibotd imports comes from Debian, for i386 has no wheels; cobs and mcap, which Debian 12 lacks and which are
plain Python, come along in the folder that is ours. The same sources give the same bytes.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shutil
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

HERE = Path(__file__).resolve().parents[1]
PARTS = HERE / "tools/packaging"
LIBRARY = "usr/lib/omnibotd"
# Debian's names for what pyproject.toml asks of PyPI; those that Debian 12 lacks are in BUNDLED.
DEBIAN = {
    "numpy": "python3-numpy",
    "opencv-python-headless": "python3-opencv",
    "scipy": "python3-scipy",
    "pyserial": "python3-serial",
    "pyusb": "python3-usb",
    "pyyaml": "python3-yaml",
    "msgpack": "python3-msgpack",
    "sdnotify": "python3-sdnotify",
}
BUNDLED = ("cobs", "mcap")
PROGRAMS = {"omnibotd": "omnibotd.daemon", "omnibotctl": "omnibotd.cli"}
PLACES = {
    "systemd/omnibotd.service": "lib/systemd/system/omnibotd.service",
    "systemd/omnibotd.sysusers": "usr/lib/sysusers.d/omnibotd.conf",
    "systemd/omnibotd.tmpfiles": "usr/lib/tmpfiles.d/omnibotd.conf",
    "systemd/99-omnibotd.rules": "lib/udev/rules.d/99-omnibotd.rules",
    "systemd/network.conf": "usr/share/doc/omnibotd/examples/network.conf",
    "config/omnibotd.yaml": "etc/omnibotd/omnibotd.yaml",
    "config/create2.yaml": "usr/share/doc/omnibotd/examples/create2.yaml",
    "config/arduino_bridge.yaml": "usr/share/doc/omnibotd/examples/arduino_bridge.yaml",
    "README.md": "usr/share/doc/omnibotd/README.md",
}
CONFFILES = ("/etc/omnibotd/omnibotd.yaml",)
# What the unit starts beside the program.
EXECUTABLES = {"systemd/back-off": f"{LIBRARY}/back-off"}
UNDATED = 1767225600  # 2026-01-01, for sources without git: the archive must not tell when it was made


class PackageError(Exception):
    """The package can't be built; the message says what is missing."""


def project() -> dict[str, Any]:
    """The [project] table of pyproject.toml."""
    with (HERE / "pyproject.toml").open("rb") as file:
        table: dict[str, Any] = tomllib.load(file)["project"]
    return table


def depends() -> str:
    """The Depends field: Debian's names and least versions for what pyproject.toml asks for.

    Raises PackageError for a requirement that is neither known to be in Debian nor bundled.
    """
    found = [f"python3 ({project()['requires-python'].replace('>=', '>= ')})", "systemd"]
    for wanted in project()["dependencies"]:
        name, _, least = wanted.partition(">=")
        if name in DEBIAN:
            found.append(f"{DEBIAN[name]} (>= {_with_epoch(name, least)})")
        elif name not in BUNDLED:
            raise PackageError(f"{name}: add its Debian name to tools/package.py, or bundle it")
    return ", ".join(found)


def _with_epoch(name: str, least: str) -> str:
    """Debian restarted numpy's version numbers once."""
    return f"1:{least}" if name == "numpy" else least


def build(out: Path, version: str | None = None) -> Path:
    """Write the package into the folder `out`; returns its path. Raises PackageError."""
    if shutil.which("dpkg-deb") is None:
        raise PackageError("dpkg-deb is missing: build on Debian, or apt-get install dpkg")
    version = version or project()["version"]
    path = out / f"omnibotd_{version}_all.deb"
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        _lay_out(tree)
        _write_control(tree, version)
        _pack(tree, path)
    return path


def _lay_out(tree: Path) -> None:
    """The installed files, as they will lie below /."""
    for name, place in PLACES.items():
        _write(tree / place, (HERE / name).read_bytes())
    for name, place in EXECUTABLES.items():
        _write(tree / place, (HERE / name).read_bytes(), 0o755)
    for name, module in PROGRAMS.items():
        _write(tree / "usr/bin" / name, _filled("program", module=module), 0o755)
    for package in ("omnibotd", "firmware_bridge"):
        for source in (HERE / package).rglob("*.py"):
            _write(tree / LIBRARY / source.relative_to(HERE), source.read_bytes())
    for name in BUNDLED:
        for file, below in _sources_of(name):
            _write(tree / LIBRARY / below, file.read_bytes())
    documents = tree / "usr/share/doc/omnibotd"
    _write(documents / "copyright", _filled("copyright", **{name: metadata.version(name) for name in BUNDLED}))


def _sources_of(name: str) -> list[tuple[Path, PurePosixPath]]:
    """The plain Python of an installed distribution, and its place below the library folder."""
    try:
        files = metadata.files(name) or []
    except metadata.PackageNotFoundError:
        files = []
    found = [(Path(str(file.locate())), PurePosixPath(file)) for file in files if file.suffix == ".py"]
    if not found:
        raise PackageError(f"{name} is not installed beside this Python: run tools/package, which sees to it")
    return [(source, place) for source, place in found if place.name != "test.py"]


def _write_control(tree: Path, version: str) -> None:
    log = f"omnibotd ({version}) bookworm; urgency=medium\n\n  * See README.md.\n\n"
    log += " -- omnibotd <root@localhost>  Thu, 01 Jan 2026 00:00:00 +0000\n"
    _write(tree / "usr/share/doc/omnibotd/changelog.gz", gzip.compress(log.encode(), mtime=0))
    kilobytes = sum(-(-path.stat().st_size // 1024) for path in tree.rglob("*") if path.is_file())
    _write(tree / "DEBIAN/control", _filled("control", version=version, kilobytes=str(kilobytes), depends=depends()))
    _write(tree / "DEBIAN/conffiles", "".join(f"{name}\n" for name in CONFFILES).encode())
    for script in ("postinst", "prerm", "postrm"):
        _write(tree / "DEBIAN" / script, (PARTS / script).read_bytes(), 0o755)


def _filled(part: str, **values: str) -> bytes:
    return (PARTS / part).read_text("utf-8").format(**values).encode()


def _write(path: Path, content: bytes, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    path.chmod(mode)


def _pack(tree: Path, path: Path) -> None:
    for folder in (tree, *(item for item in tree.rglob("*") if item.is_dir())):
        folder.chmod(0o755)  # whatever the umask
    stamp = os.environ.get("SOURCE_DATE_EPOCH") or str(_committed())
    # Young files get this stamp, and all of these are young.
    environment = {**os.environ, "SOURCE_DATE_EPOCH": stamp}
    command = ["dpkg-deb", "--root-owner-group", "-Zxz", "--build", str(tree), str(path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise PackageError(done.stderr.strip())


def _committed() -> int:
    """Seconds since 1970 of the last commit."""
    command = ["git", "-C", str(HERE), "log", "-1", "--format=%ct"]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        said = ""
    return int(said) if said.isdecimal() else UNDATED


def main() -> int:
    """Exit status 1 where something is missing."""
    parser = argparse.ArgumentParser(prog="tools/package", description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE / "out", metavar="FOLDER")
    try:
        path = build(parser.parse_args().out)
    except PackageError as error:
        print(f"tools/package: {error}", file=sys.stderr)
        return 1
    print(path)
    print(f"install it, as root: apt-get install {path}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
