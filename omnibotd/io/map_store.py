"""The storage directory: maps, their recordings, and which map is in use. Blocking: call it from a thread."""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import re
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.io import map_format
from omnibotd.io.map_format import MapFormatError

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_RECORDING = re.compile(r"(?P<map>[A-Za-z0-9_-]{1,64})\.(?P<number>[0-9]{4,})\.mcap")


class MapStoreError(Exception):
    """A file of the store can't be used; the message names it and says what to do. Nothing was changed."""


@dataclass(frozen=True, slots=True)
class MapEntry:
    """A map of the store; `nodes` is None where its file can't be read, 0 where there are only recordings."""

    name: str
    bytes: int
    nodes: int | None
    recording_bytes: int = 0


@dataclass(frozen=True, slots=True)
class SectionReport:
    name: str
    bytes: int
    ok: bool


@dataclass(frozen=True, slots=True)
class MapReport:
    """What `verify` found: `ok` only when the map would load; the message is one sentence."""

    ok: bool
    sections: tuple[SectionReport, ...]
    message: str


class MapStore:
    """Maps by name in one directory: NAME.omap, the version before as NAME.omap~, recordings/NAME.0001.mcap.

    A file appears under its name only when it is whole and on the disk. Saving keeps the version before,
    deleting makes the map its own version before; recordings are never deleted.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._recordings = directory / "recordings"
        with _telling(f"storage directory {directory}"):
            self._recordings.mkdir(parents=True, exist_ok=True)

    def save(self, topo_map: TopoMap) -> int:
        """Write the map and return its bytes; where that fails, the map before stays (MapStoreError)."""
        path = self._path(topo_map.name)
        with _telling(f"map {path}"), _alone(self.directory) as sync:
            data = map_format.encode(topo_map)
            map_format.decode(topo_map.name, io.BytesIO(data), len(data))  # what can't be loaded must not replace
            new = _written(path, data)
            self._keep_previous(path)
            os.replace(new, path)
            sync()
        return len(data)

    def load(self, name: str) -> TopoMap:
        path = self._existing(name)
        with _telling(f"map {path}"), path.open("rb") as stream:
            return map_format.decode(name, stream, _size(stream))

    def list(self) -> list[MapEntry]:
        """Every map, trained or only recorded, by name."""
        recorded = self._recorded()
        trained = {path.stem for path in self.directory.glob("*.omap") if _NAME.fullmatch(path.stem)}
        return [self._entry(name, recorded.get(name, [])) for name in sorted(trained | recorded.keys())]

    def verify(self, name: str) -> MapReport:
        """Read every byte of the map and report by section; raises MapStoreError where there is none."""
        path = self._existing(name)
        sections: list[SectionReport] = []
        try:
            with path.open("rb") as stream:
                found = map_format.read_header(stream, _size(stream))
                sections = [SectionReport(part.name, part.stored, _intact(stream, part)) for part in found]
            nodes = len(self.load(name))
        except (MapStoreError, MapFormatError, OSError) as error:
            return MapReport(False, tuple(sections), f"map {path}: {str(error).removeprefix(f'map {path}: ')}")
        return MapReport(True, tuple(sections), f"map {name}: {nodes} nodes, all sections are intact")

    def delete(self, name: str) -> Path:
        """Take the map out of use and return where it stays, NAME.omap~, until a map of that name is saved twice."""
        path = self._existing(name)
        with _telling(f"map {path}"), _alone(self.directory) as sync:
            os.replace(path, _previous(path))
            sync()
        if self.active() == name:
            self.set_active(None)
        return _previous(path)

    def file(self, name: str) -> Path:
        """The file of a map that exists."""
        return self._existing(name)

    def adopt(self, name: str, new: Path) -> int:
        """Give a file of this directory the name of a map that must not exist yet; returns its nodes.

        It is read whole first: what can't be loaded gets no name.
        """
        path = self._path(name)
        with _telling(f"map {name!r}"), _alone(self.directory) as sync:
            if path.exists():
                raise MapStoreError(f"map {name!r} exists already: delete it first, or choose another name")
            with new.open("rb") as stream:
                count = len(map_format.decode(name, stream, _size(stream)))
                os.fsync(stream.fileno())
            os.replace(new, path)
            sync()
        return count

    def recordings(self, name: str) -> Sequence[Path]:
        """All recordings of a map, oldest first."""
        return self._recorded().get(_checked(name), [])

    def active(self) -> str | None:
        """The map to use at the next start; None where none was chosen."""
        try:
            name = (self.directory / "active").read_text("ascii").strip()
        except (OSError, UnicodeDecodeError):
            return None
        return name if _NAME.fullmatch(name) else None

    def set_active(self, name: str | None) -> None:
        """Remember the map; it must exist."""
        if name is not None:
            self._existing(name)
        path = self.directory / "active"
        with _telling(str(path)), _alone(self.directory) as sync:
            os.replace(_written(path, f"{name or ''}\n".encode()), path)
            sync()

    def recording_path(self, name: str) -> Path:
        """The newest recording of a map."""
        recordings = self._recorded().get(_checked(name), [])
        if not recordings:
            raise MapStoreError(f"no recording of map {name!r} in {self._recordings}: record one first")
        return recordings[-1]

    def new_recording_path(self, name: str) -> Path:
        """Where the next recording of a map belongs. Numbered, as a cheap computer's clock may jump back."""
        recordings = self._recorded().get(_checked(name), [])
        number = _number(recordings[-1]) + 1 if recordings else 1
        return self._recordings / f"{name}.{number:04}.mcap"

    def _path(self, name: str) -> Path:
        return self.directory / f"{_checked(name)}.omap"

    def _existing(self, name: str) -> Path:
        path = self._path(name)
        if path.is_file():
            return path
        if _previous(path).exists():
            raise MapStoreError(f"no map {name!r}, but its version before: rename {_previous(path)} to {path.name}")
        if name in self._recorded():
            raise MapStoreError(f"map {name!r} is recorded, but not trained: train it first")
        names = ", ".join(entry.name for entry in self.list() if entry.nodes != 0)
        raise MapStoreError(f"no map {name!r} in {self.directory}; maps: {names or 'none'}")

    def _entry(self, name: str, recordings: Sequence[Path]) -> MapEntry:
        path = self._path(name)
        recorded = sum(recording.stat().st_size for recording in recordings)
        try:
            with path.open("rb") as stream:
                size = _size(stream)
                return MapEntry(name, size, map_format.nodes(map_format.read_header(stream, size)), recorded)
        except FileNotFoundError:
            return MapEntry(name, 0, 0, recorded)
        except (MapFormatError, OSError):
            return MapEntry(name, path.stat().st_size, None, recorded)

    def _recorded(self) -> dict[str, Sequence[Path]]:
        """Recordings of every map, oldest first."""
        found = defaultdict(set)
        with _telling(f"storage directory {self._recordings}"):
            for path in self._recordings.iterdir():
                if match := _RECORDING.fullmatch(path.name):
                    found[match["map"]].add(path)
        return {name: sorted(paths, key=_number) for name, paths in found.items()}

    def _keep_previous(self, path: Path) -> None:
        """A sound map becomes the version before; a damaged one goes aside, not over a sound one."""
        if not path.exists():
            return
        if not self.verify(path.stem).ok:
            os.replace(path, path.with_name(f"{path.name}.damaged"))
            return
        spare = path.with_name(f".{path.name}.spare")
        spare.unlink(missing_ok=True)
        try:
            os.link(path, spare)
        except OSError:  # FAT has no links
            shutil.copyfile(path, spare)
        os.replace(spare, _previous(path))


def _checked(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise MapStoreError(f"{name!r} can't name a map: use 1 to 64 letters, digits, '_' and '-'")
    return name


def _number(recording: Path) -> int:
    return int(recording.name.split(".")[1])


def _previous(path: Path) -> Path:
    return path.with_name(f"{path.name}~")


def _written(path: Path, data: bytes) -> Path:
    """A temporary neighbour of `path` with the data, on the disk. A left-over of a crash is overwritten."""
    new = path.with_name(f".{path.name}.new")
    with new.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
    return new


@contextlib.contextmanager
def _alone(directory: Path) -> Iterator[Callable[[], None]]:
    """Keeps other threads and processes (training is one) from saving; gives what makes renames last on the disk."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield lambda: os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _size(stream: BinaryIO) -> int:
    return os.fstat(stream.fileno()).st_size


def _intact(stream: BinaryIO, section: map_format.Section) -> bool:
    try:
        map_format.read_section(stream, section)
    except MapFormatError:
        return False
    return True


@contextlib.contextmanager
def _telling(what: str) -> Iterator[None]:
    """What goes wrong inside is told with the name of what it went wrong with."""
    try:
        yield
    except MapFormatError as error:
        raise MapStoreError(f"{what}: {error}") from error
    except OSError as error:
        raise MapStoreError(f"{what}: {error.strerror or error}") from error
