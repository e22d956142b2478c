"""A map's arrays in its file: to the last tenth of a millimetre, link by link, and no index out of range."""

from __future__ import annotations

import dataclasses
import io
import struct
import zlib
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omnibotd.core.mapping.topo_map import Edges, TopoMap
from omnibotd.io import map_format
from omnibotd.io.map_arrays import LAYOUTS, MapFormatError, restored, stored

Pairs = list[tuple[int, int, int]]


def linked_map(nodes: int, links: Pairs) -> TopoMap:
    first, second, kind = np.array(links, np.int64).reshape(-1, 3).T
    return TopoMap(
        name="flat",
        codebook=np.ones((4, 3), np.float32),
        units=np.zeros(nodes, np.uint16),
        snapshots=np.zeros((nodes, 5), np.uint8),
        poses=np.zeros((nodes, 3), np.float32),
        sessions=np.zeros(nodes, np.uint16),
        edges=Edges(first.astype(np.int32), second.astype(np.int32), kind.astype(np.uint8)),
    )


def sizes(topo_map: TopoMap) -> dict[str, int]:
    """Bytes of each section in the file."""
    data = map_format.encode(topo_map)
    return {section.name: section.stored for section in map_format.read_header(io.BytesIO(data), len(data))}


def header_of(data: bytes) -> dict[str, Any]:
    length = int.from_bytes(data[8:12], "little")
    header: dict[str, Any] = msgpack.unpackb(data[16 : 16 + length])
    return header


def with_header(data: bytes, header: dict[str, Any]) -> bytes:
    """The file with another header, its checksum right."""
    packed = msgpack.packb(header)
    body = data[16 + int.from_bytes(data[8:12], "little") :]
    return data[:8] + struct.pack("<II", len(packed), zlib.crc32(packed)) + packed + body


def pruned_drive(nodes: int, gaps: int) -> Pairs:
    """Links of a drive from which nodes were taken: some neighbours across a gap stay linked, others are not."""
    missing = set(np.random.default_rng(7).choice(nodes - 1, gaps, replace=False).tolist())
    return [(k, k + 1, 0) for k in range(nodes - 1) if k not in missing]


@given(st.lists(st.tuples(st.integers(0, 49), st.integers(0, 49), st.integers(0, 2)), max_size=60))
@settings(max_examples=60, deadline=None)
def test_any_links_come_back_as_they_were(links: Pairs) -> None:
    edges = restored(stored(linked_map(50, links)))["edges"]
    back = zip(edges.first.tolist(), edges.second.tolist(), edges.kind.tolist(), strict=True)
    assert sorted(back) == sorted((min(a, b), max(a, b), kind) for a, b, kind in links)
    assert (edges.first.dtype, edges.second.dtype, edges.kind.dtype) == (np.int32, np.int32, np.uint8)


@given(st.lists(st.tuples(*3 * [st.floats(-2e5, 2e5, width=32)]), min_size=1, max_size=30))
@settings(max_examples=60, deadline=None)
def test_poses_come_back_to_half_a_unit(rows: list[tuple[float, float, float]]) -> None:
    poses = np.array(rows, np.float32)
    topo_map = dataclasses.replace(linked_map(len(rows), []), poses=poses)
    back = restored(stored(topo_map))["poses"]
    assert back.dtype == np.float32
    # Half of 0.1 mm, and the rounding of float32 where numbers are large.
    np.testing.assert_allclose(back, poses, rtol=2e-7, atol=0.51e-4)


def test_saving_again_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    topo_map = dataclasses.replace(linked_map(40, pruned_drive(40, 5)), poses=rng.normal(size=(40, 3)).astype("f4"))
    once = map_format.encode(topo_map)
    assert map_format.encode(map_format.decode("flat", io.BytesIO(once), len(once))) == once


def test_the_links_of_a_drive_take_no_room_and_those_of_a_pruned_one_little() -> None:
    drive = sizes(linked_map(4000, pruned_drive(4000, 0)))
    pruned = sizes(linked_map(4000, pruned_drive(4000, 200)))
    assert sum(drive[name] for name in drive if name.startswith("edges.")) < 200
    # A gap is its place and what is left out, in either column.
    assert sum(pruned[name] for name in pruned if name.startswith("edges.")) < 200 + 4 * 200


def test_revisits_take_three_bytes_a_link() -> None:
    # Every node of the second half was seen again from near a node of the first.
    rng = np.random.default_rng(8)
    links = [(max(0, k - 1000 + int(rng.integers(-3, 4))), k, 1) for k in range(1000, 2000) for _ in range(3)]
    found = sizes(linked_map(2000, links))
    assert found["edges.first"] + found["edges.second"] + found["edges.kind"] < 3 * len(links)


@pytest.mark.parametrize(
    ("change", "section"),
    [
        ({"codebook": np.full((4, 3), 1e6, np.float32)}, "codebook"),
        ({"codebook": np.full((4, 3), np.nan, np.float32)}, "codebook"),
        ({"poses": np.full((9, 3), np.inf, np.float32)}, "poses"),
        ({"poses": np.full((9, 3), -3e5, np.float32)}, "poses"),
        ({"edges": Edges(np.zeros(2, np.int32), np.zeros(1, np.int32), np.zeros(2, np.uint8))}, "edges.first"),
    ],
)
def test_what_a_file_can_not_hold_is_told(change: dict[str, Any], section: str) -> None:
    with pytest.raises(MapFormatError, match="can't be saved") as told:
        map_format.encode(dataclasses.replace(linked_map(9, []), **change))
    assert told.value.section == section


@given(st.sampled_from(["edges.first", "edges.second"]), st.binary(min_size=60, max_size=60))
@settings(max_examples=100, deadline=None)
def test_damaged_differences_never_become_an_index_out_of_range(section: str, noise: bytes) -> None:
    arrays = stored(linked_map(16, pruned_drive(16, 0)))
    arrays[section] = np.frombuffer(noise, "<i4")
    try:
        edges = restored(arrays)["edges"]
    except MapFormatError as told:
        assert told.section == section
    else:
        indices = np.concatenate([edges.first, edges.second])
        assert ((indices >= 0) & (indices < 16)).all()


@pytest.mark.parametrize(
    ("section", "array"),
    [
        ("edges.first", np.array([2**31 - 1, 2], "<i4")),  # runs over
        ("edges.second", np.array([-1, 1], "<i4")),
        ("edges.kind", np.array([0, 3], "|u1")),
        ("edges.kind", np.array([0], "|u1")),
        ("units", np.array(9 * [4], "<u2")),
        ("snapshots", np.zeros((8, 5), "|u1")),
        ("codebook", np.full((4, 3), np.inf, "<f2")),
    ],
)
def test_arrays_that_do_not_fit_together_are_damage(section: str, array: np.ndarray[Any, Any]) -> None:
    arrays = stored(linked_map(9, [(0, 1, 0), (1, 2, 0)]))
    arrays[section] = array
    with pytest.raises(MapFormatError, match="damaged") as told:
        restored(arrays)
    assert told.value.section == section


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_noise_in_a_header_that_checks_out_is_refused_or_harmless(seed: int) -> None:
    data = map_format.encode(linked_map(16, pruned_drive(16, 0)))
    header, rng = header_of(data), np.random.default_rng(seed)
    entry = header["sections"][rng.integers(len(header["sections"]))]
    key = ["name", "stored", "size", "crc32", "codec", "dtype", "shape"][rng.integers(7)]
    entry[key] = [0, -1, 2**40, "zlib", [], [16], [2**40], [2**20, 3], None, {}][rng.integers(10)]
    forged = with_header(data, header)
    try:
        found = map_format.decode("flat", io.BytesIO(forged), len(forged))
    except MapFormatError:
        return
    assert len(found) == 16


def test_an_older_version_is_to_be_trained_again() -> None:
    data = map_format.encode(linked_map(3, []))
    old = with_header(data, header_of(data) | {"version": 1})
    with pytest.raises(MapFormatError, match=r"version 1.*older omnibotd: train it again"):
        map_format.decode("flat", io.BytesIO(old), len(old))


def test_every_array_of_the_file_is_little_endian() -> None:
    assert all(layout.dtype[0] in "<|" for layout in LAYOUTS.values())
