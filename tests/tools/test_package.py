"""The Debian package: what is in it, what it asks for, and that it only needs what it says."""

import ast
import os
import re
import stat
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tools import package

# Import names that differ from the Debian package that has them (without its `python3-`).
IMPORTED_AS = {"cv2": "opencv"}


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    try:
        return package.build(tmp_path_factory.mktemp("deb"))
    except package.PackageError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory) -> Path:
    """The package's files below a folder."""
    root = tmp_path_factory.mktemp("root")
    subprocess.run(["dpkg-deb", "-x", built, root], check=True)
    return root


def field(built: Path, name: str) -> str:
    return subprocess.run(["dpkg-deb", "-f", built, name], capture_output=True, text=True, check=True).stdout.strip()


def test_it_brings_programs_unit_rules_and_configuration(installed):
    for place in (
        "usr/bin/omnibotd",
        "usr/bin/omnibotctl",
        "lib/systemd/system/omnibotd.service",
        "lib/udev/rules.d/99-omnibotd.rules",
        "usr/lib/sysusers.d/omnibotd.conf",
        "usr/lib/tmpfiles.d/omnibotd.conf",
        "etc/omnibotd/omnibotd.yaml",
        "usr/share/doc/omnibotd/copyright",
    ):
        assert (installed / place).is_file(), place


def test_what_the_unit_starts_is_in_the_package(installed):
    unit = (installed / "lib/systemd/system/omnibotd.service").read_text()
    started = re.findall(r"^Exec\w+=(\S+)", unit, re.MULTILINE)
    assert len(started) == 2
    assert all(os.access(installed / program.lstrip("/"), os.X_OK) for program in started)


def test_the_configuration_is_the_owners(built):
    listed = subprocess.run(["dpkg-deb", "-I", built, "conffiles"], capture_output=True, text=True, check=True).stdout
    assert listed.split() == ["/etc/omnibotd/omnibotd.yaml"]


def test_every_file_is_roots_and_only_programs_are_executable(built):
    tar = subprocess.run(["dpkg-deb", "--fsys-tarfile", built], capture_output=True, check=True).stdout
    path = built.with_suffix(".tar")
    path.write_bytes(tar)
    with tarfile.open(path) as members:
        for member in members:
            assert (member.uid, member.gid) == (0, 0), member.name
            programs = member.name.startswith("./usr/bin/") or member.name.endswith("/back-off")
            allowed = 0o755 if member.isdir() or programs else 0o644
            assert stat.S_IMODE(member.mode) == allowed, member.name


def test_nothing_in_it_is_for_one_architecture(built, installed):
    assert field(built, "Architecture") == "all"
    assert not [path for path in installed.rglob("*") if path.suffix in {".so", ".pyc"}]


def test_whatever_it_imports_comes_along_or_is_a_dependency(built, installed):
    """Independent of the table in tools/package: read from the sources as installed."""
    named = {re.sub(r" .*|^python3-", "", part) for part in field(built, "Depends").split(", ")}
    library = installed / "usr/lib/omnibotd"
    ours = {path.name for path in library.iterdir() if path.is_dir()}
    assert {"omnibotd", "firmware_bridge", "mcap", "cobs"} <= ours
    for source in (*(library / "omnibotd").rglob("*.py"), *(library / "firmware_bridge").rglob("*.py")):
        for module in imported(source):
            known = module in ours or module in sys.stdlib_module_names or IMPORTED_AS.get(module, module) in named
            assert known, f"{source}: {module}"


def imported(source: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.add(node.module.partition(".")[0])
    return found


def test_the_same_sources_make_the_same_bytes(built, tmp_path):
    first = package.build(tmp_path / "first")
    before = os.umask(0o077)
    try:
        again = package.build(tmp_path / "again")
    finally:
        os.umask(before)
    assert again.read_bytes() == first.read_bytes()


def test_the_scripts_of_the_package_are_shell(built, tmp_path):
    subprocess.run(["dpkg-deb", "-e", built, tmp_path], check=True)
    for script in ("postinst", "prerm", "postrm"):
        assert os.access(tmp_path / script, os.X_OK)
        subprocess.run(["sh", "-n", tmp_path / script], check=True)


@pytest.mark.parametrize("program", ["omnibotd", "omnibotctl"])
def test_a_program_and_its_children_use_the_installed_files_alone(installed, tmp_path, program):
    """Started elsewhere, beside a folder of the same name, and with this Python for Debian's."""
    (tmp_path / "omnibotd").mkdir()
    (tmp_path / "omnibotd/__init__.py").write_text("raise SystemExit('the wrong one')")
    text = (installed / "usr/bin" / program).read_text()
    text = text.replace("/usr/lib/omnibotd", str(installed / "usr/lib/omnibotd"))
    text = text.replace("/usr/bin/python3", sys.executable)
    done = subprocess.run(
        ["sh", "-c", text, program, "--help"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: {program}")


def test_a_new_requirement_must_be_placed(monkeypatch):
    monkeypatch.setattr(package, "project", lambda: {"requires-python": ">=3.11", "dependencies": ["flask>=3"]})
    with pytest.raises(package.PackageError, match="flask"):
        package.depends()


def test_falls_that_follow_each_other_are_waited_for_and_a_stop_forgets_them(tmp_path):
    """The script with a `sleep` that only notes: what it would wait after each end of the daemon."""
    noting = tmp_path / "bin"
    noting.mkdir()
    (noting / "sleep").write_text(f'#!/bin/sh\necho "$1" >>{tmp_path}/slept\n')
    (noting / "sleep").chmod(0o755)

    def ended(result: str) -> list[str]:
        (tmp_path / "slept").write_text("")
        environment = {"PATH": f"{noting}:/usr/bin:/bin", "RUNTIME_DIRECTORY": str(tmp_path), "SERVICE_RESULT": result}
        subprocess.run(["sh", package.HERE / "systemd/back-off"], env=environment, check=True)
        return (tmp_path / "slept").read_text().split()

    waits = [ended(result) for result in ("watchdog", "signal", "exit-code", "signal", "signal", "success", "signal")]
    assert waits == [[], ["1"], ["3"], ["7"], ["7"], [], []]
    os.utime(tmp_path / "falls", (0, 0))
    assert ended("signal") == []
