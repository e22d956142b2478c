"""Maps on disk: nothing changes on the way, nothing saved is lost, nothing damaged is believed."""

from __future__ import annotations

import dataclasses
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock, DockView, Edges, TopoMap
from omnibotd.io import map_format
from omnibotd.io.map_store import MapStore, MapStoreError

ARRAYS = ("codebook", "units", "snapshots", "poses", "sessions")
EDGE_ARRAYS = ("first", "second", "kind")
HEADER_AT = 16


def made_map(name: str = "flat", nodes: int = 60, links: int = 90, seed: int = 1) -> TopoMap:
    """Whatever a file can hold exactly: its links are in its order, its numbers as coarse as its units."""
    rng = np.random.default_rng(seed)
    first, second, kind = (rng.integers(0, end, links) for end in (nodes - 1, nodes, 3))
    second = np.maximum(first + 1, second)
    order = np.lexsort((first, second, kind))
    edges = Edges(
        first=first[order].astype(np.int32), second=second[order].astype(np.int32), kind=kind[order].astype(np.uint8)
    )
    views = (DockView(b"\xff\xd8" + rng.bytes(500)), DockView(rng.bytes(300), Pose2D(0.002, -0.001, 0.01)))
    return TopoMap(
        name=name,
        codebook=rng.normal(size=(16, 24)).astype(np.float16).astype(np.float32),
        units=rng.integers(0, 16, nodes, np.uint16),
        snapshots=rng.integers(0, 256, (nodes, 32), np.uint8),
        poses=(rng.integers(-30000, 30000, (nodes, 3)) / 1e4).astype(np.float32),
        sessions=np.zeros(nodes, np.uint16),
        edges=edges,
        ceiling_height=2.2,
        recordings=("flat.0001.mcap",),
        method="thesis",
        camera={"fov_deg": 190.0, "width": 640.0},
        statistics={"quantization_error": 0.123456789},
        places={"Küche": Pose2D(1.25, -3.5, 3.0), "desk": Pose2D()},
        docks={"home": Dock(Pose2D(0.1, 0.2, -1.5), views)},
    )


def assert_same(left: TopoMap, right: TopoMap) -> None:
    for owner_left, owner_right, names in ((left, right, ARRAYS), (left.edges, right.edges, EDGE_ARRAYS)):
        for name in names:
            expected, found = getattr(owner_left, name), getattr(owner_right, name)
            assert (expected.dtype, expected.shape) == (found.dtype, found.shape), name
            np.testing.assert_array_equal(expected, found, name)
    plain = {"name", "recordings", "method", "camera", "statistics", "places", "docks"}
    assert {field.name for field in dataclasses.fields(TopoMap)} == {*ARRAYS, "edges", "ceiling_height", *plain}
    assert all(getattr(left, name) == getattr(right, name) for name in plain)
    assert np.array_equal(left.ceiling_height, right.ceiling_height, equal_nan=True)


@pytest.fixture
def store(tmp_path: Path) -> MapStore:
    return MapStore(tmp_path / "deep" / "store")


@pytest.fixture
def file(store: MapStore, tmp_path: Path) -> Path:
    """A saved map's file."""
    store.save(made_map())
    return tmp_path / "deep" / "store" / "flat.omap"


def older_docks(topo_map: TopoMap) -> dict[str, Any]:
    """As they were written before docks had several views."""
    return {
        name: {"pose": [dock.map_from_dock.x, dock.map_from_dock.y, dock.map_from_dock.yaw], "snapshot": b"\xff\xd8old"}
        for name, dock in topo_map.docks.items()
    }


def test_docks_of_an_older_file_have_one_view(store: MapStore, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as older:
        older.setattr(map_format, "_docks", older_docks)
        store.save(made_map())
    expected = Dock(Pose2D(0.1, 0.2, -1.5), (DockView(b"\xff\xd8old"),))
    assert store.load("flat").docks == {"home": expected}


@pytest.mark.parametrize(
    "dock",
    [
        {"pose": [0, 0, 0]},
        {"pose": [0, 0, 0], "views": []},
        {"pose": [0, 0, 0], "views": [{"pose": [0, 0, 0], "snapshot": "text"}]},
        {"pose": [0, 0, 0], "views": [{"pose": [0, 0], "snapshot": b"x"}]},
        {"pose": [0, 0, 0], "views": 7},
        {"pose": [0, 0, 0], "views": [7]},
        7,
    ],
)
def test_a_malformed_dock_is_damage(store: MapStore, monkeypatch: pytest.MonkeyPatch, dock: object) -> None:
    monkeypatch.setattr(map_format, "_docks", lambda topo_map: {"home": dock})
    with pytest.raises(MapStoreError, match="section 'docks'"):
        store.save(made_map())


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"ceiling_height": float("nan")},
        {"places": {}, "docks": {}, "camera": {}, "statistics": {}},
        {"sessions": np.arange(60, dtype=np.uint16) * 1000},
    ],
)
def test_what_is_loaded_is_what_was_saved(store: MapStore, change: dict[str, Any]) -> None:
    saved = dataclasses.replace(made_map(), **change)
    store.save(saved)
    assert_same(saved, store.load("flat"))


def test_a_map_without_nodes_or_links_survives(store: MapStore) -> None:
    empty = Edges(*(array[:0] for array in (getattr(made_map().edges, name) for name in EDGE_ARRAYS)))
    saved = dataclasses.replace(
        made_map(), edges=empty, **{name: getattr(made_map(), name)[:0] for name in ARRAYS if name != "codebook"}
    )
    store.save(saved)
    assert_same(saved, store.load("flat"))


def test_the_name_is_the_files(store: MapStore, file: Path) -> None:
    file.rename(file.with_name("attic.omap"))
    assert store.load("attic").name == "attic"


def test_what_repeats_is_stored_compressed(store: MapStore) -> None:
    plain = dataclasses.replace(made_map(nodes=2000), snapshots=np.zeros((2000, 512), np.uint8))
    assert store.save(plain) < 200_000


def test_the_documented_layout_can_be_read_without_us(file: Path) -> None:
    data = file.read_bytes()
    length, crc = struct.unpack_from("<II", data, 8)
    header = msgpack.unpackb(data[HEADER_AT : HEADER_AT + length])
    assert zlib.crc32(data[HEADER_AT : HEADER_AT + length]) == crc
    at = HEADER_AT + length
    for entry in header["sections"]:
        body = data[at : at + entry["stored"]]
        assert zlib.crc32(body) == entry["crc32"]
        if entry["name"] == "poses":
            inflated = zlib.decompress(body) if entry["codec"] == "zlib" else body
            steps = np.frombuffer(inflated, entry["dtype"]).reshape(entry["shape"])
            np.testing.assert_allclose(steps.cumsum(0) * 1e-4, made_map().poses, atol=1e-6)
        at += entry["stored"]
    assert at == len(data)


def test_a_flipped_byte_anywhere_is_refused_and_the_file_left_alone(store: MapStore, file: Path) -> None:
    sound = file.read_bytes()
    rng = np.random.default_rng(2)
    for position in {*range(400), *rng.integers(0, len(sound), 400).tolist(), len(sound) - 1}:
        damaged = bytearray(sound)
        damaged[position] ^= int(rng.integers(1, 256))
        file.write_bytes(damaged)
        with pytest.raises(MapStoreError, match=r"flat\.omap"):
            store.load("flat")
        assert file.read_bytes() == damaged


def test_a_truncated_map_is_refused(store: MapStore, file: Path) -> None:
    sound = file.read_bytes()
    for length in [*range(40), *range(40, len(sound), 37), len(sound) - 1]:
        file.write_bytes(sound[:length])
        with pytest.raises(MapStoreError, match=r"flat\.omap"):
            store.load("flat")


def test_bytes_behind_the_end_are_refused(store: MapStore, file: Path) -> None:
    file.write_bytes(file.read_bytes() + b"x")
    with pytest.raises(MapStoreError, match="follow the last section"):
        store.load("flat")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 a zip", b"\x89PNG\r\n\x1a\n" + bytes(100), b"\x80\x04."])
def test_a_foreign_file_is_named_as_such(store: MapStore, file: Path, content: bytes) -> None:
    file.write_bytes(content)
    with pytest.raises(MapStoreError, match="no omnibotd map"):
        store.load("flat")
    assert store.verify("flat").ok is False
    assert store.list()[0].nodes is None


def rewritten(file: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """The file with another header, its checksum right: what only a check of the content can refuse."""
    data = file.read_bytes()
    length = struct.unpack_from("<I", data, 8)[0]
    header = msgpack.unpackb(data[HEADER_AT : HEADER_AT + length])
    change(header)
    packed = msgpack.packb(header)
    file.write_bytes(
        data[:8] + struct.pack("<II", len(packed), zlib.crc32(packed)) + packed + data[HEADER_AT + length :]
    )


def entry(header: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(entry for entry in header["sections"] if entry["name"] == name)
    return found


def huge(header: dict[str, Any]) -> None:
    entry(header, "poses").update(shape=[10**12, 3], size=12 * 10**12)


def huge_but_stored_small(header: dict[str, Any]) -> None:
    entry(header, "snapshots").update(codec="zlib", shape=[10**12, 32], size=32 * 10**12)


def longer_than_the_file(header: dict[str, Any]) -> None:
    header["sections"][-1].update(stored=10**9, size=10**9, codec="zlib")


def another_dtype(header: dict[str, Any]) -> None:
    entry(header, "poses")["dtype"] = "|O"


def one_missing(header: dict[str, Any]) -> None:
    entry(header, "sessions")["name"] = "session"


def one_twice(header: dict[str, Any]) -> None:
    header["sections"].append(dict(entry(header, "codebook"), stored=0))


def negative(header: dict[str, Any]) -> None:
    entry(header, "poses")["stored"] = -5


def text_for_number(header: dict[str, Any]) -> None:
    entry(header, "poses")["size"] = "many"


def no_sections(header: dict[str, Any]) -> None:
    header["sections"] = []


def unknown_codec(header: dict[str, Any]) -> None:
    entry(header, "poses")["codec"] = "pickle"


def not_deflated(header: dict[str, Any]) -> None:
    entry(header, "snapshots")["codec"] = "zlib"


@pytest.mark.parametrize(
    "change",
    [
        huge,
        huge_but_stored_small,
        longer_than_the_file,
        another_dtype,
        one_missing,
        one_twice,
        negative,
        text_for_number,
        no_sections,
        unknown_codec,
        not_deflated,
    ],
)
def test_a_header_that_lies_is_refused_before_anything_is_allocated(
    store: MapStore, file: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    rewritten(file, change)
    with pytest.raises(MapStoreError, match=r"flat\.omap: section .*train it again"):
        store.load("flat")


def test_a_newer_version_asks_for_an_upgrade(store: MapStore, file: Path) -> None:
    rewritten(file, lambda header: header.update(version=99))
    with pytest.raises(MapStoreError, match="newer omnibotd: upgrade"):
        store.load("flat")


@pytest.mark.parametrize(
    "change",
    [
        {"units": np.full(60, 16, np.uint16)},
        {"sessions": np.zeros(59, np.uint16)},
        {"snapshots": np.zeros((60, 2, 2), np.uint8)},
        {"edges": dataclasses.replace(made_map().edges, first=np.full(90, 60, np.int32))},
        {"edges": dataclasses.replace(made_map().edges, second=np.full(90, -1, np.int32))},
        {"edges": dataclasses.replace(made_map().edges, kind=np.zeros(3, np.uint8))},
        {"edges": dataclasses.replace(made_map().edges, kind=np.full(90, 3, np.uint8))},
        {"poses": np.full((60, 3), np.nan, np.float32)},
    ],
)
def test_what_could_not_be_loaded_never_replaces_what_can(store: MapStore, file: Path, change: dict[str, Any]) -> None:
    sound = file.read_bytes()
    with pytest.raises(MapStoreError):
        store.save(dataclasses.replace(made_map(), **change))
    assert file.read_bytes() == sound


@pytest.mark.parametrize("call", ["fsync", "replace", "link"])
def test_a_crash_while_saving_leaves_the_map_whole(
    store: MapStore, file: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    class PowerCut(BaseException):
        pass

    def cut(*_: object) -> None:
        raise PowerCut

    with monkeypatch.context() as patch:
        patch.setattr(os, call, cut)
        with pytest.raises(PowerCut):
            store.save(made_map(seed=2))
    assert_same(made_map(), MapStore(file.parent).load("flat"))
    assert [entry.name for entry in store.list()] == ["flat"]
    store.save(made_map(seed=3))
    assert_same(made_map(seed=3), store.load("flat"))


def test_a_full_disk_is_told_and_the_map_stays(store: MapStore, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MapStoreError, match=r"flat\.omap: No space left"):
        store.save(made_map(seed=2))
    assert_same(made_map(), store.load("flat"))


def test_the_version_before_is_kept(store: MapStore, file: Path) -> None:
    first = file.read_bytes()
    store.save(made_map(seed=2))
    assert file.with_name("flat.omap~").read_bytes() == first


def test_the_version_before_is_kept_where_there_are_no_links(
    store: MapStore, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    first = file.read_bytes()
    monkeypatch.setattr(os, "link", no_links)
    store.save(made_map(seed=2))
    assert file.with_name("flat.omap~").read_bytes() == first


def test_a_damaged_map_is_put_aside_and_does_not_push_out_a_sound_one(store: MapStore, file: Path) -> None:
    first = file.read_bytes()
    store.save(made_map(seed=2))
    file.write_bytes(file.read_bytes()[:-1])
    damaged = file.read_bytes()
    store.save(made_map(seed=3))
    assert file.with_name("flat.omap~").read_bytes() == first
    assert file.with_name("flat.omap.damaged").read_bytes() == damaged


def test_a_deleted_map_is_gone_but_can_be_had_back(store: MapStore, file: Path) -> None:
    store.set_active("flat")
    store.delete("flat")
    assert store.list() == []
    assert store.active() is None
    with pytest.raises(MapStoreError, match=r"rename .*flat\.omap~ to flat\.omap"):
        store.load("flat")


@pytest.mark.parametrize("name", ["", "../flat", "a/b", ".", "..", "a" * 65, "flat.omap", "a b", "ä", "a\n", "a\0"])
def test_a_name_is_no_path(store: MapStore, name: str) -> None:
    calls: list[Callable[[], object]] = [
        lambda: store.load(name),
        lambda: store.save(made_map(name)),
        lambda: store.verify(name),
        lambda: store.delete(name),
        lambda: store.set_active(name),
        lambda: store.recording_path(name),
        lambda: store.new_recording_path(name),
    ]
    for call in calls:
        with pytest.raises(MapStoreError, match="can't name a map"):
            call()


def test_a_map_that_is_not_there_is_told_with_those_that_are(store: MapStore, file: Path) -> None:
    with pytest.raises(MapStoreError, match=r"no map 'attic'.*maps: flat"):
        store.load("attic")


def test_the_list_tells_nodes_bytes_and_recordings(store: MapStore, file: Path) -> None:
    store.new_recording_path("attic").write_bytes(bytes(1000))
    store.new_recording_path("flat").write_bytes(bytes(30))
    store.new_recording_path("flat").write_bytes(bytes(40))
    attic, flat = store.list()
    assert (attic.name, attic.bytes, attic.nodes, attic.recording_bytes) == ("attic", 0, 0, 1000)
    assert (flat.name, flat.bytes, flat.nodes, flat.recording_bytes) == ("flat", file.stat().st_size, 60, 70)


def test_verify_tells_the_damaged_section(store: MapStore, file: Path) -> None:
    sound = store.verify("flat")
    assert sound.ok
    assert all(section.ok for section in sound.sections)
    assert len(sound.sections) == 10
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)
    damaged = store.verify("flat")
    assert not damaged.ok
    assert [section.name for section in damaged.sections if not section.ok] == ["docks"]
    assert "section 'docks'" in damaged.message


def test_the_active_map_is_remembered(store: MapStore, file: Path) -> None:
    assert store.active() is None
    store.set_active("flat")
    assert MapStore(file.parent).active() == "flat"
    with pytest.raises(MapStoreError):
        store.set_active("attic")
    assert store.active() == "flat"
    store.set_active(None)
    assert store.active() is None


@pytest.mark.parametrize("content", [b"../../etc/passwd\n", b"\xff\xfe", b"", b"a b"])
def test_nonsense_in_the_active_file_is_no_map(store: MapStore, file: Path, content: bytes) -> None:
    file.with_name("active").write_bytes(content)
    assert store.active() is None


def test_recordings_are_numbered_and_the_newest_is_the_highest(store: MapStore) -> None:
    with pytest.raises(MapStoreError, match="record one first"):
        store.recording_path("flat")
    for _ in range(11):
        newest = store.new_recording_path("flat")
        assert not newest.exists()
        newest.touch()
    store.new_recording_path("flat-2").touch()
    assert newest.name == "flat.0011.mcap"
    assert store.recording_path("flat") == newest


def test_a_directory_that_can_not_be_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MapStoreError, match="storage directory"):
        MapStore(tmp_path / "file" / "store")
