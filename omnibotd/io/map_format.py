"""The bytes of a `.omap` file (layout in MAP_FORMAT.md): a checked header, then checked sections."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import msgpack
import numpy as np
from numpy.typing import NDArray

from omnibotd import __version__
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock, DockView, TopoMap
from omnibotd.io.map_arrays import DAMAGED, LAYOUTS, MapFormatError, restored, stored

__all__ = ["VERSION", "MapFormatError", "Section", "decode", "encode", "nodes", "read_header", "read_section"]

VERSION = 2
_MAGIC = b"\x89OMAP\r\n\x1a"  # the high bit and both newlines catch a transfer as text
_LENGTH_AND_CRC = struct.Struct("<II")
_MAX_HEADER = 64 * 1024  # thirteen sections take one and a half kilobytes
_MAX_SECTION = 512 * 1024 * 1024  # snapshots of a million nodes, whatever the method: a thousand hours of teaching
_PAYS = 0.9  # compress what shrinks below this; the rest would only cost loading time

_RECORDS = ("info", "docks")


@dataclass(frozen=True, slots=True)
class Section:
    """Where a part of the file lies; `stored` and `size` are its bytes before and after inflating."""

    name: str
    offset: int
    stored: int
    size: int
    codec: str
    crc32: int
    dtype: str = ""
    shape: tuple[int, ...] = field(default=())


def encode(topo_map: TopoMap) -> bytes:
    """The whole file. The map's name is not in it: a map is called what its file is called."""
    entries, bodies = [], []
    for name, data, array in _parts(topo_map):
        body, codec = _packed(data)
        entry: dict[str, Any] = {"name": name, "codec": codec, "stored": len(body), "size": len(data)}
        entries.append(entry | {"crc32": zlib.crc32(body)} | array)
        bodies.append(body)
    header = msgpack.packb({"version": VERSION, "writer": f"omnibotd {__version__}", "sections": entries})
    return b"".join([_MAGIC, _LENGTH_AND_CRC.pack(len(header), zlib.crc32(header)), header, *bodies])


def _parts(topo_map: TopoMap) -> list[tuple[str, bytes, dict[str, Any]]]:
    parts: list[tuple[str, bytes, dict[str, Any]]] = [
        (name, array.tobytes(), {"dtype": LAYOUTS[name].dtype, "shape": list(array.shape)})
        for name, array in stored(topo_map).items()
    ]
    parts += [("info", msgpack.packb(_info(topo_map)), {}), ("docks", msgpack.packb(_docks(topo_map)), {})]
    return parts


def _info(topo_map: TopoMap) -> dict[str, Any]:
    return {
        "ceiling_height": float(topo_map.ceiling_height),
        "method": topo_map.method,
        "recordings": list(topo_map.recordings),
        "camera": {key: float(value) for key, value in topo_map.camera.items()},
        "statistics": {key: float(value) for key, value in topo_map.statistics.items()},
        "places": {name: _triple(pose) for name, pose in topo_map.places.items()},
    }


def _docks(topo_map: TopoMap) -> dict[str, Any]:
    return {
        name: {
            "pose": _triple(dock.map_from_dock),
            "views": [{"pose": _triple(view.dock_from_base), "snapshot": view.jpeg} for view in dock.views],
        }
        for name, dock in topo_map.docks.items()
    }


def _triple(pose: Pose2D) -> list[float]:
    return [float(pose.x), float(pose.y), float(pose.yaw)]


def _packed(data: bytes) -> tuple[bytes, str]:
    small = zlib.compress(data, 6)
    return (small, "zlib") if len(small) < _PAYS * len(data) else (data, "raw")


def read_header(stream: BinaryIO, file_size: int) -> list[Section]:
    """The sections of the file, whose bounds are checked against its size. Raises MapFormatError."""
    start = stream.read(len(_MAGIC) + _LENGTH_AND_CRC.size)
    if not start.startswith(_MAGIC):
        raise MapFormatError("header", "this is no omnibotd map: leave it to the program that made it")
    if len(start) < len(_MAGIC) + _LENGTH_AND_CRC.size:
        raise MapFormatError("header", f"the file ends here; {DAMAGED}")
    length, crc = _LENGTH_AND_CRC.unpack_from(start, len(_MAGIC))
    if length > min(_MAX_HEADER, file_size):
        raise MapFormatError("header", f"{length} bytes long, which can't be; {DAMAGED}")
    header = stream.read(length)
    if len(header) < length or zlib.crc32(header) != crc:
        raise MapFormatError("header", f"its checksum is wrong; {DAMAGED}")
    return _sections(header, len(start) + length, file_size)


def _sections(header: bytes, offset: int, file_size: int) -> list[Section]:
    sections = []
    for entry in _entries(header):
        section = _section(entry, offset)
        offset += section.stored
        if offset > file_size:
            raise MapFormatError(section.name, f"the file ends {offset - file_size} bytes before it does; {DAMAGED}")
        sections.append(section)
    if offset != file_size:
        raise MapFormatError(sections[-1].name, f"{file_size - offset} bytes follow the last section; {DAMAGED}")
    missing = {*LAYOUTS, *_RECORDS} ^ {section.name for section in sections}
    if missing or len(sections) != len(LAYOUTS) + len(_RECORDS):
        raise MapFormatError("header", f"sections missing or unknown: {', '.join(sorted(missing))}; {DAMAGED}")
    return sections


def _entries(header: bytes) -> list[Any]:
    content = _unpacked("header", header)
    version = content.get("version")
    if version != VERSION:
        told = f"format version {version!r}, this omnibotd reads {VERSION}"
        raise MapFormatError("header", f"{told}; {_advice(version)}")
    entries = content.get("sections")
    if not isinstance(entries, list) or not entries:
        raise MapFormatError("header", f"no list of sections; {DAMAGED}")
    return entries


def _advice(version: object) -> str:
    if not isinstance(version, int) or version < 1:
        return DAMAGED
    if version > VERSION:
        return "made by a newer omnibotd: upgrade"
    return "made by an older omnibotd: train it again from its recording"


def _section(entry: Any, offset: int) -> Section:
    """Every number is checked here, before anybody allocates by it."""
    try:
        name, codec, dtype = (_text(entry.get(key, "")) for key in ("name", "codec", "dtype"))
        stored, size, crc = (_count(entry[key]) for key in ("stored", "size", "crc32"))
        shape = tuple(_count(length) for length in entry.get("shape", ()))
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise MapFormatError("header", f"a section's entry is malformed ({error!r}); {DAMAGED}") from error
    if size > _MAX_SECTION or (codec == "raw" and size != stored):
        raise MapFormatError(name, f"claims {size} bytes, which can't be; {DAMAGED}")
    if codec not in {"raw", "zlib"}:
        raise MapFormatError(name, f"unknown codec {codec!r}; {DAMAGED}")
    if name in LAYOUTS:
        _check_shape(name, dtype, shape, size)
    return Section(name, offset, stored, size, codec, crc, dtype, shape)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no text")
    return value


def _count(value: object) -> int:
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} is no count")
    return value


def _check_shape(name: str, dtype: str, shape: tuple[int, ...], size: int) -> None:
    layout = LAYOUTS[name]
    lengths = (-1, *layout.inner)
    fits = len(shape) == len(lengths) and all(want in {-1, have} for want, have in zip(lengths, shape, strict=True))
    if dtype != layout.dtype or not fits:
        raise MapFormatError(name, f"{dtype} {shape} where {layout.dtype} {('n', *layout.inner)} belongs; {DAMAGED}")
    if math.prod(shape) * np.dtype(dtype).itemsize != size:
        raise MapFormatError(name, f"shape {shape} does not take {size} bytes; {DAMAGED}")


def nodes(sections: list[Section]) -> int:
    """How many nodes the header tells of."""
    return next(section.shape[0] for section in sections if section.name == "poses")


def read_section(stream: BinaryIO, section: Section) -> bytes:
    """The bytes of a section, checked and inflated. Raises MapFormatError."""
    stream.seek(section.offset)
    body = stream.read(section.stored)
    if len(body) != section.stored or zlib.crc32(body) != section.crc32:
        raise MapFormatError(section.name, f"its checksum is wrong; {DAMAGED}")
    if section.codec == "raw":
        return body
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(body, section.size + 1)
    except zlib.error as error:
        raise MapFormatError(section.name, f"can't be inflated: {error}; {DAMAGED}") from error
    if len(data) != section.size:
        raise MapFormatError(section.name, f"inflates to another size than {section.size}; {DAMAGED}")
    return data


def decode(name: str, stream: BinaryIO, file_size: int) -> TopoMap:
    """The map in a file, called `name`. Raises MapFormatError."""
    sections = {section.name: section for section in read_header(stream, file_size)}
    fields = restored({key: _array(stream, sections[key]) for key in LAYOUTS})
    info = _unpacked("info", read_section(stream, sections["info"]))
    docks = _unpacked("docks", read_section(stream, sections["docks"]))
    return TopoMap(name=name, **fields, **_facts(info), docks=_dock_table(docks))


def _array(stream: BinaryIO, section: Section) -> NDArray[Any]:
    return np.frombuffer(read_section(stream, section), section.dtype).reshape(section.shape)


def _unpacked(section: str, data: bytes) -> dict[str, Any]:
    try:
        content = msgpack.unpackb(data)
    except (ValueError, msgpack.UnpackException) as error:
        raise MapFormatError(section, f"is no msgpack ({error}); {DAMAGED}") from error
    if not isinstance(content, dict):
        raise MapFormatError(section, f"is no msgpack map; {DAMAGED}")
    return content


def _facts(info: dict[str, Any]) -> dict[str, Any]:
    try:
        return {
            "ceiling_height": float(info["ceiling_height"]),
            "method": str(info["method"]),
            "recordings": tuple(str(name) for name in info["recordings"]),
            "camera": {str(key): float(value) for key, value in info["camera"].items()},
            "statistics": {str(key): float(value) for key, value in info["statistics"].items()},
            "places": {str(name): _pose(triple) for name, triple in info["places"].items()},
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise MapFormatError("info", f"an entry is malformed ({error!r}); {DAMAGED}") from error


def _dock_table(docks: dict[str, Any]) -> dict[str, Dock]:
    try:
        return {str(name): Dock(_pose(dock["pose"]), _views(dock)) for name, dock in docks.items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise MapFormatError("docks", f"an entry is malformed ({error!r}); {DAMAGED}") from error


def _views(dock: dict[str, Any]) -> tuple[DockView, ...]:
    """At least one; the dock of an older file has a single view, taken at its pose."""
    views = dock.get("views", [{"pose": (0.0, 0.0, 0.0), "snapshot": dock.get("snapshot")}])
    if not views:
        raise ValueError("a dock without a view")
    return tuple(DockView(_picture(view["snapshot"]), _pose(view["pose"])) for view in views)


def _picture(value: Any) -> bytes:
    if not isinstance(value, bytes):
        raise TypeError("a snapshot that is no picture")
    return value


def _pose(triple: Any) -> Pose2D:
    x, y, yaw = (float(value) for value in triple)
    return Pose2D(x, y, yaw)
