"""The daemon's listening Unix socket: one daemon a path, open to its group, no stale file in the way."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import grp
import logging
import os
import socket
import stat
import struct
from collections.abc import Iterator
from pathlib import Path

log = logging.getLogger(__name__)

_MODE = 0o660
_PEERCRED = struct.Struct("3i")  # struct ucred: pid, uid, gid


class ControlSocketError(Exception):
    """The socket can't be opened; the message says why and what to do."""


def listen(path: Path, group: str | None) -> socket.socket:
    """A bound socket, mode 0660, of `group` where one is named and exists. Raises ControlSocketError."""
    if not path.parent.is_dir():
        raise ControlSocketError(f"control socket {path}: no directory {path.parent}: create it, or set control.socket")
    try:
        with _only_one(path.parent):
            _clear(path)
            return _bind(path, group)
    except OSError as error:
        raise ControlSocketError(f"control socket {path}: {error.strerror or error}") from error


@contextlib.contextmanager
def _only_one(directory: Path) -> Iterator[None]:
    """Holds a lock on the directory: two daemons that start at once must not both take a socket for stale."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _clear(path: Path) -> None:
    """Remove what a crashed daemon left; refuse when it is no socket or somebody listens."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise ControlSocketError(f"control socket {path}: a file that is no socket is in the way: move it elsewhere")
    if _answers(path):
        raise ControlSocketError(f"control socket {path}: another omnibotd listens there: stop it first")
    log.warning("removing the stale control socket %s", path)
    path.unlink()


def _answers(path: Path) -> bool:
    """Whether somebody listens: only a refused connection proves that nobody does."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        result = probe.connect_ex(str(path))
    return result not in {errno.ECONNREFUSED, errno.ENOENT}


def _bind(path: Path, group: str | None) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(path))
        path.chmod(_MODE)
        if group is not None:
            _give_to(path, group)
    except BaseException:
        listener.close()
        raise
    return listener


def _give_to(path: Path, group: str) -> None:
    try:
        os.chown(path, -1, grp.getgrnam(group).gr_gid)
    except KeyError:
        log.warning("no group %r here: only user %d and root can use %s", group, os.getuid(), path)
    except PermissionError:
        log.warning(
            "user %d may not give %s to group %r: only this user and root can use it",
            os.getuid(),
            path,
            group,
        )


def peer(connection: socket.socket) -> tuple[int, int]:
    """(pid, uid) of the process at the other end, as the kernel knows it."""
    pid, uid, _gid = _PEERCRED.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEERCRED.size))
    return pid, uid
