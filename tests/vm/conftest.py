"""The suite of virtual machines: started only by name (`-m vm`), for it takes a quarter of an hour and needs root.

A tool that can't be had skips it and says so; where CI is set, that is a failure.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import debian_image
import pytest
from rig import Rig

from tools import package

HERE = Path(__file__).resolve().parent
KEPT = HERE.parents[1] / "out/vm"
FOUND = pytest.StashKey[dict[str, tuple[float, str]]]()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "vm: a Debian guest in QEMU (tools/test -m vm tests/vm)")
    config.stash[FOUND] = {}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if "vm" in (config.option.markexpr or ""):
        return
    ours = [item for item in items if item.path.is_relative_to(HERE)]
    items[:] = [item for item in items if item not in ours]
    config.hook.pytest_deselected(items=ours)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """The table, and as JSON in out/vm/found.json."""
    found = config.stash[FOUND]
    if not found:
        return
    terminalreporter.section("measured in the guest, by its own clock")
    for name, (amount, unit) in found.items():
        terminalreporter.write_line(f"{name:<62} {amount:7.2f} {unit}")
    table = {name: {"amount": amount, "unit": unit} for name, (amount, unit) in found.items()}
    (KEPT / "found.json").write_text(json.dumps(table, indent=1) + "\n")


@pytest.fixture(scope="session")
def debian() -> Path:
    """A Debian system, in a folder, that has all our package needs but not the package."""
    if missing := debian_image.lacking():
        reason = f"no virtual machine here: {missing}"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    KEPT.mkdir(parents=True, exist_ok=True)
    root = debian_image.debian(KEPT)
    if (root / "usr/bin/omnibotd").exists():  # of a run before this one
        debian_image.inside(root, "dpkg", "--purge", "omnibotd")
    debian_image.inside(root, "rm", "-rf", "/var/lib/omnibotd", "/etc/omnibotd")
    return root


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The package, and one that is newer by its number alone."""
    folder = tmp_path_factory.mktemp("packages")
    return package.build(folder), package.build(folder, f"{package.project()['version']}+next")


@pytest.fixture(scope="session")
def rig(debian: Path, packages: tuple[Path, Path], pytestconfig: pytest.Config) -> Iterator[Rig]:
    """A running guest with nothing plugged in, the robot outside, and a table to fill."""
    debian_image.install(debian, packages[0])
    # A short path: a Unix socket's has at most 107 bytes.
    with TemporaryDirectory(prefix="omnibot-vm-") as folder:
        rig = Rig(debian_image.image(debian, KEPT), Path(folder), pytestconfig.stash[FOUND])
        try:
            rig.guest.wait()
            yield rig
        finally:
            rig.close()
