"""Maps out of the store and into it, piece by piece: bit for bit, and whole or not at all. Blocking.

A client reads and writes its own files with its own rights; what travels fits the socket's lines, and no map is ever
held in memory whole.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from omnibotd.io.map_store import MapStore, MapStoreError

PIECE = 256 * 1024  # bytes a client is sent at once; one it sends is limited by the length of a request
MAX_IMPORT = 1024**3  # bytes; a map of a million nodes is half as large
SPARE_DISK = 64 * 1024**2  # bytes an import leaves free: recordings and edits of maps need room, too


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes of a map's file, `total` in all; `version` names the content they are from."""

    data: bytes
    total: int
    version: str


def read_piece(store: MapStore, name: str, offset: int, version: str | None) -> Piece:
    """The next piece of a map's file. MapStoreError for a damaged map, and where `version` is not its content."""
    path = store.file(name)
    if offset == 0 and not (report := store.verify(name)).ok:
        raise MapStoreError(report.message)
    try:
        with path.open("rb") as stream:
            stat = os.fstat(stream.fileno())
            found = f"{stat.st_ino:x}.{stat.st_mtime_ns:x}.{stat.st_size:x}"
            if version not in (None, found):
                raise MapStoreError(f"map {name!r} was saved anew while it was exported: export it again")
            stream.seek(offset)
            return Piece(stream.read(PIECE), stat.st_size, found)
    except OSError as error:
        raise MapStoreError(f"map {path}: {error.strerror or error}") from error


class Incoming:
    """A map on its way into the store, in one temporary file: there is one at a time."""

    def __init__(self, store: MapStore, name: str, total: int, sha256: str) -> None:
        """Raises MapStoreError where the disk has no room for `total` bytes."""
        self.name, self.received = name, 0
        self._store, self.total, self._sha256 = store, total, sha256
        self._path = store.directory / ".import"
        self._hash = hashlib.sha256()
        if not 0 < total <= MAX_IMPORT:
            raise MapStoreError(f"{total} bytes are no map: they have 1 to {MAX_IMPORT}")
        free = shutil.disk_usage(store.directory).free
        if free < total + SPARE_DISK:
            raise MapStoreError(f"{store.directory}: {free} bytes are free, the map takes {total}: delete something")
        try:
            self._stream = self._path.open("wb")
        except OSError as error:
            raise MapStoreError(f"{self._path}: {error.strerror or error}") from error

    def add(self, offset: int, data: bytes) -> bool:
        """Append a piece; True once all are there. MapStoreError for one that does not follow the last."""
        if offset != self.received or self.received + len(data) > self.total:
            raise MapStoreError(f"the piece at byte {offset} does not follow the {self.received} received")
        try:
            self._stream.write(data)
        except OSError as error:
            raise MapStoreError(f"{self._path}: {error.strerror or error}") from error
        self._hash.update(data)
        self.received += len(data)
        return self.received == self.total

    def publish(self) -> int:
        """Give the map its name, once it has been read whole; returns its nodes."""
        self._stream.close()
        if self._hash.hexdigest() != self._sha256:
            raise MapStoreError(f"map {self.name!r} arrived damaged: import it again")
        return self._store.adopt(self.name, self._path)

    def discard(self) -> None:
        """Forget what came; nothing happens after `publish`."""
        self._stream.close()
        self._path.unlink(missing_ok=True)


def same_content(store: MapStore, name: str, sha256: str) -> bool | None:
    """Whether the store's map of this name has just this content; None where there is no such map."""
    try:
        path = store.file(name)
    except MapStoreError:
        return None
    return digest(path) == sha256


def digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
