"""The bytes of a `.omap` file (layout in MAP_FORMAT.md): a checked header, then checked sections."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import msgpack
import numpy as np
from numpy.typing import NDArray

from omnibotd import __version__
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock, Edges, TopoMap

VERSION = 2
_MAGIC = b"\x89OMAP\r\n\x1a"  # the high bit and both newlines catch a transfer as text
_LENGTH_AND_CRC = struct.Struct("<II")
_MAX_HEADER = 64 * 1024  # thirteen sections take one and a half kilobytes
_MAX_SECTION = 512 * 1024 * 1024  # a million nodes of 512 bytes: two thousand hours of teaching
_PAYS = 0.9  # compress what shrinks below this; floats hardly do and would only cost loading time
_DAMAGED = "it is damaged: restore it from a backup, or train it again from its recording"

_NODES = {"units": ("<u2", ()), "snapshots": ("|u1", (-1,)), "poses": ("<f4", (3,)), "sessions": ("<u2", ())}
_EDGES = {
    "edges.first": ("<i4", ()),
    "edges.second": ("<i4", ()),
    "edges.kind": ("|u1", ()),
}
_ARRAYS = {"codebook": ("<f4", (-1,)), **_NODES, **_EDGES}  # dtype and what follows the first axis; -1 is any
_RECORDS = ("info", "docks")


class MapFormatError(Exception):
    """The bytes are no map we can use; `section` says where, the message what and what to do."""

    def __init__(self, section: str, message: str) -> None:
        super().__init__(f"section {section!r}: {message}")
        self.section = section


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
    parts = []
    for name, (dtype, _) in _ARRAYS.items():
        array = np.ascontiguousarray(_field(topo_map, name), dtype=dtype)
        parts.append((name, array.tobytes(), {"dtype": dtype, "shape": list(array.shape)}))
    parts += [("info", msgpack.packb(_info(topo_map)), {}), ("docks", msgpack.packb(_docks(topo_map)), {})]
    return parts


def _field(topo_map: TopoMap, section: str) -> NDArray[Any]:
    owner, _, name = section.rpartition(".")
    values: NDArray[Any] = getattr(topo_map.edges if owner else topo_map, name)
    return values


def _info(topo_map: TopoMap) -> dict[str, Any]:
    return {
        "ceiling_height": float(topo_map.ceiling_height),
        "recordings": list(topo_map.recordings),
        "camera": {key: float(value) for key, value in topo_map.camera.items()},
        "statistics": {key: float(value) for key, value in topo_map.statistics.items()},
        "places": {name: _triple(pose) for name, pose in topo_map.places.items()},
    }


def _docks(topo_map: TopoMap) -> dict[str, Any]:
    return {
        name: {"pose": _triple(dock.map_from_dock), "snapshot": dock.snapshot} for name, dock in topo_map.docks.items()
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
        raise MapFormatError("header", f"the file ends here; {_DAMAGED}")
    length, crc = _LENGTH_AND_CRC.unpack_from(start, len(_MAGIC))
    if length > min(_MAX_HEADER, file_size):
        raise MapFormatError("header", f"{length} bytes long, which can't be; {_DAMAGED}")
    header = stream.read(length)
    if len(header) < length or zlib.crc32(header) != crc:
        raise MapFormatError("header", f"its checksum is wrong; {_DAMAGED}")
    return _sections(header, len(start) + length, file_size)


def _sections(header: bytes, offset: int, file_size: int) -> list[Section]:
    sections = []
    for entry in _entries(header):
        section = _section(entry, offset)
        offset += section.stored
        if offset > file_size:
            raise MapFormatError(section.name, f"the file ends {offset - file_size} bytes before it does; {_DAMAGED}")
        sections.append(section)
    if offset != file_size:
        raise MapFormatError(sections[-1].name, f"{file_size - offset} bytes follow the last section; {_DAMAGED}")
    missing = {*_ARRAYS, *_RECORDS} ^ {section.name for section in sections}
    if missing or len(sections) != len(_ARRAYS) + len(_RECORDS):
        raise MapFormatError("header", f"sections missing or unknown: {', '.join(sorted(missing))}; {_DAMAGED}")
    return sections


def _entries(header: bytes) -> list[Any]:
    content = _unpacked("header", header)
    version = content.get("version")
    if version != VERSION:
        advice = "made by a newer omnibotd: upgrade" if isinstance(version, int) and version > VERSION else _DAMAGED
        raise MapFormatError("header", f"format version {version!r}, this omnibotd reads {VERSION}; {advice}")
    entries = content.get("sections")
    if not isinstance(entries, list) or not entries:
        raise MapFormatError("header", f"no list of sections; {_DAMAGED}")
    return entries


def _section(entry: Any, offset: int) -> Section:
    """Every number is checked here, before anybody allocates by it."""
    try:
        name, codec, dtype = entry["name"], entry["codec"], entry.get("dtype", "")
        stored, size, crc = (_count(entry[key]) for key in ("stored", "size", "crc32"))
        shape = tuple(_count(length) for length in entry.get("shape", ()))
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise MapFormatError("header", f"a section's entry is malformed ({error!r}); {_DAMAGED}") from error
    if size > _MAX_SECTION or (codec == "raw" and size != stored):
        raise MapFormatError(str(name), f"claims {size} bytes, which can't be; {_DAMAGED}")
    if codec not in {"raw", "zlib"}:
        raise MapFormatError(str(name), f"unknown codec {codec!r}; {_DAMAGED}")
    if name in _ARRAYS:
        _check_shape(name, dtype, shape, size)
    return Section(str(name), offset, stored, size, codec, crc, dtype, shape)


def _count(value: object) -> int:
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} is no count")
    return value


def _check_shape(name: str, dtype: str, shape: tuple[int, ...], size: int) -> None:
    expected, inner = _ARRAYS[name]
    fits = len(shape) == 1 + len(inner) and all(want in {-1, have} for want, have in zip(inner, shape[1:], strict=True))
    if dtype != expected or not fits:
        raise MapFormatError(name, f"{dtype} {shape} where {expected} {('n', *inner)} belongs; {_DAMAGED}")
    if math.prod(shape) * np.dtype(expected).itemsize != size:
        raise MapFormatError(name, f"shape {shape} does not take {size} bytes; {_DAMAGED}")


def nodes(sections: list[Section]) -> int:
    """How many nodes the header tells of."""
    return next(section.shape[0] for section in sections if section.name == "poses")


def read_section(stream: BinaryIO, section: Section) -> bytes:
    """The bytes of a section, checked and inflated. Raises MapFormatError."""
    stream.seek(section.offset)
    body = stream.read(section.stored)
    if len(body) != section.stored or zlib.crc32(body) != section.crc32:
        raise MapFormatError(section.name, f"its checksum is wrong; {_DAMAGED}")
    if section.codec == "raw":
        return body
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(body, section.size + 1)
    except zlib.error as error:
        raise MapFormatError(section.name, f"can't be inflated: {error}; {_DAMAGED}") from error
    if len(data) != section.size:
        raise MapFormatError(section.name, f"inflates to another size than {section.size}; {_DAMAGED}")
    return data


def decode(name: str, stream: BinaryIO, file_size: int) -> TopoMap:
    """The map in a file, called `name`. Raises MapFormatError."""
    sections = {section.name: section for section in read_header(stream, file_size)}
    arrays = {key: _array(stream, sections[key]) for key in _ARRAYS}
    _check_agreement(arrays)
    info = _unpacked("info", read_section(stream, sections["info"]))
    docks = _unpacked("docks", read_section(stream, sections["docks"]))
    return TopoMap(
        name=name,
        codebook=arrays["codebook"],
        units=arrays["units"],
        snapshots=arrays["snapshots"],
        poses=arrays["poses"],
        sessions=arrays["sessions"],
        edges=Edges(**{key.removeprefix("edges."): arrays[key] for key in _EDGES}),
        **_facts(info),
        docks=_dock_table(docks),
    )


def _array(stream: BinaryIO, section: Section) -> NDArray[Any]:
    data = read_section(stream, section)
    array = np.frombuffer(data, section.dtype).reshape(section.shape)
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _check_agreement(arrays: Mapping[str, NDArray[Any]]) -> None:
    """Indices must point at something: a wrong one would fail far from here, while driving."""
    count = len(arrays["poses"])
    for group, length in ((_NODES, count), (_EDGES, len(arrays["edges.first"]))):
        for name in group:
            if len(arrays[name]) != length:
                raise MapFormatError(name, f"{len(arrays[name])} entries where {length} belong; {_DAMAGED}")
    for name, limit in (("units", len(arrays["codebook"])), ("edges.first", count), ("edges.second", count)):
        values = arrays[name]
        if values.size and (values.min() < 0 or values.max() >= limit):
            raise MapFormatError(name, f"an index is outside 0..{limit - 1}; {_DAMAGED}")


def _unpacked(section: str, data: bytes) -> dict[str, Any]:
    try:
        content = msgpack.unpackb(data)
    except (ValueError, msgpack.UnpackException) as error:
        raise MapFormatError(section, f"is no msgpack ({error}); {_DAMAGED}") from error
    if not isinstance(content, dict):
        raise MapFormatError(section, f"is no msgpack map; {_DAMAGED}")
    return content


def _facts(info: dict[str, Any]) -> dict[str, Any]:
    try:
        return {
            "ceiling_height": float(info["ceiling_height"]),
            "recordings": tuple(str(name) for name in info["recordings"]),
            "camera": {str(key): float(value) for key, value in info["camera"].items()},
            "statistics": {str(key): float(value) for key, value in info["statistics"].items()},
            "places": {str(name): _pose(triple) for name, triple in info["places"].items()},
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise MapFormatError("info", f"an entry is malformed ({error!r}); {_DAMAGED}") from error


def _dock_table(docks: dict[str, Any]) -> dict[str, Dock]:
    try:
        return {str(name): Dock(_pose(dock["pose"]), bytes(dock["snapshot"])) for name, dock in docks.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise MapFormatError("docks", f"an entry is malformed ({error!r}); {_DAMAGED}") from error


def _pose(triple: Any) -> Pose2D:
    x, y, yaw = (float(value) for value in triple)
    return Pose2D(x, y, yaw)
