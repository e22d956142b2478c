"""A stock Debian 12 with the package installed, as files: a folder to enter by chroot, and a disk for a guest."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tools import package

NEEDED = {
    "mmdebstrap": "mmdebstrap",
    "mke2fs": "e2fsprogs",
    "dpkg-deb": "dpkg",
    "qemu-system-x86_64": "qemu-system-x86",
}
# What any PC has, then what lets the test in: an agent to run commands, socat for the control line.
SYSTEM = "linux-image-amd64,systemd-sysv,udev,kmod,dbus,initramfs-tools,zstd,procps,qemu-guest-agent,socat"
SOURCES = Path("/etc/apt/sources.list.d/debian.sources")  # this machine's own, for it may have a mirror
DISK = "3G"

CONFIG = """\
camera: {source: /dev/video0, fps: 5}
base: {driver: omnibot, port: "usb:0403:6001", max_linear_velocity: 0.4, max_angular_velocity: 1.5}
"""
# The person outside drives by the same socket as any client; QEMU's line leads to it.
CONTROL_LINE = """\
[Unit]
StartLimitIntervalSec=0
[Service]
ExecStart=/usr/bin/socat OPEN:/dev/virtio-ports/control UNIX-CONNECT:/run/omnibotd/control.sock
Restart=always
RestartSec=0.5
[Install]
WantedBy=multi-user.target
"""


def lacking() -> str:
    """What this machine lacks for a guest, as a sentence; empty if nothing."""
    missing = [package for program, package in NEEDED.items() if shutil.which(program) is None]
    if missing:
        return f"apt-get install {' '.join(missing)}"
    return "" if os.getuid() == 0 else "to make a Debian system takes root"


@dataclass(frozen=True, slots=True)
class Image:
    """A guest's disk and what to boot it with."""

    disk: Path
    kernel: Path
    initrd: Path


def debian(folder: Path) -> Path:
    """The system without our package but with all it depends on; made anew only where that is another; 2 GB."""
    root, made = folder / "debian", folder / "debian.made"
    packages = ",".join([SYSTEM, *(part.partition(" ")[0] for part in package.depends().split(", "))])
    if not made.exists() or made.read_text() != packages:
        shutil.rmtree(root, ignore_errors=True)
        subprocess.run(_mmdebstrap(root, packages), check=True)
        made.write_text(packages)
    return root


def _mmdebstrap(root: Path, packages: str) -> list[str]:
    # An initial ramdisk with the drivers of this one machine boots in a third of the time.
    small = (
        'mkdir -p "$1/etc/initramfs-tools/conf.d" && '
        'printf "MODULES=list\\nCOMPRESS=zstd\\nCOMPRESSLEVEL=1\\n" >"$1/etc/initramfs-tools/conf.d/zz-vm.conf" && '
        'printf "virtio_pci\\nvirtio_blk\\next4\\ncrc32c_generic\\n" >"$1/etc/initramfs-tools/modules"'
    )
    return [
        *("mmdebstrap", "--quiet", "--mode=root", "--variant=minbase", "--format=directory"),
        *(f"--include={packages}", '--aptopt=APT::Install-Recommends "false"', f"--essential-hook={small}"),
        *(f"--dpkgopt=path-exclude=/usr/share/{part}/*" for part in ("doc", "man", "locale")),
        *("bookworm", str(root)),
        *([str(SOURCES)] if SOURCES.exists() and "bookworm" in SOURCES.read_text() else []),
    ]


def inside(root: Path, *command: str) -> str:
    """What a command says inside the system. Raises CalledProcessError, with what it said in its notes."""
    environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    done = subprocess.run(["chroot", root, *command], env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        error = subprocess.CalledProcessError(done.returncode, command)
        error.add_note(done.stdout + done.stderr)
        raise error
    return done.stdout


def install(root: Path, deb: Path) -> None:
    """The one command of the README."""
    shutil.copy(deb, root / "tmp")
    inside(root, "apt-get", "install", "--yes", f"/tmp/{deb.name}")


def image(root: Path, folder: Path) -> Image:
    """A disk of the system as it is now, with our configuration and a line for the test."""
    etc = root / "etc"
    (etc / "omnibotd/omnibotd.yaml").write_text(CONFIG)
    (etc / "hostname").write_text("robotpc\n")
    (etc / "hosts").write_text("127.0.0.1 localhost robotpc\n")
    (etc / "fstab").write_text("/dev/vda / ext4 defaults,noatime 0 1\n")
    (etc / "machine-id").write_text("uninitialized\n")
    (etc / "systemd/system/control-line.service").write_text(CONTROL_LINE)
    inside(root, "systemctl", "--quiet", "enable", "control-line.service")
    # They would start in the middle of a measurement.
    inside(root, "systemctl", "--quiet", "mask", "apt-daily.timer", "apt-daily-upgrade.timer", "e2scrub_all.timer")
    disk = folder / "disk.img"
    disk.unlink(missing_ok=True)
    plain = ["-q", "-t", "ext4", "-F", "-E", "lazy_itable_init=1,nodiscard", "-O", "^metadata_csum"]
    subprocess.run(["mke2fs", *plain, "-d", str(root), str(disk), DISK], check=True)
    (kernel,) = (root / "boot").glob("vmlinuz-*")
    (initrd,) = (root / "boot").glob("initrd.img-*")
    return Image(disk, kernel, initrd)
