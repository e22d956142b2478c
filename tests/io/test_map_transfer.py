"""Maps travel in pieces: bit for bit out of the store, whole or not at all into it."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.io import map_transfer
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.io.map_transfer import Incoming, read_piece, same_content
from tests.made_maps import made_map


@pytest.fixture
def store(tmp_path: Path) -> MapStore:
    store = MapStore(tmp_path)
    store.save(made_map("flat"))
    return store


@pytest.fixture(autouse=True)
def short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_transfer, "PIECE", 1000)


def exported(store: MapStore, name: str) -> bytes:
    data, version = b"", None
    while True:
        piece = read_piece(store, name, len(data), version)
        data, version = data + piece.data, piece.version
        if len(data) >= piece.total:
            return data


def import_all(store: MapStore, name: str, data: bytes, sha256: str | None = None) -> int:
    incoming = Incoming(store, name, len(data), sha256 or hashlib.sha256(data).hexdigest())
    try:
        for at in range(0, len(data), 700):
            complete = incoming.add(at, data[at : at + 700])
        assert complete
        return incoming.publish()
    finally:
        incoming.discard()


def test_an_export_is_the_file_bit_for_bit_in_many_pieces(store: MapStore) -> None:
    on_disk = store.file("flat").read_bytes()
    assert len(on_disk) > 2000
    assert exported(store, "flat") == on_disk


def test_a_map_saved_anew_meanwhile_is_not_mixed_with_the_one_before(store: MapStore) -> None:
    first = read_piece(store, "flat", 0, None)
    store.save(made_map("flat").with_place("new", Pose2D()))
    with pytest.raises(MapStoreError, match="export it again"):
        read_piece(store, "flat", len(first.data), first.version)


def test_a_damaged_map_is_not_exported_as_if_it_were_sound(store: MapStore) -> None:
    data = bytearray(store.file("flat").read_bytes())
    data[-1] ^= 1
    store.file("flat").write_bytes(data)
    with pytest.raises(MapStoreError, match="section 'docks'"):
        read_piece(store, "flat", 0, None)


def test_what_comes_in_is_what_went_out(store: MapStore) -> None:
    data = exported(store, "flat")
    assert import_all(store, "attic", data) == len(made_map())
    assert store.file("attic").read_bytes() == data
    assert [entry.name for entry in store.list()] == ["attic", "flat"]
    assert not (store.directory / ".import").exists()


def test_half_a_map_never_appears(store: MapStore) -> None:
    data = exported(store, "flat")
    incoming = Incoming(store, "attic", len(data), hashlib.sha256(data).hexdigest())
    assert not incoming.add(0, data[:1000])
    assert [entry.name for entry in store.list()] == ["flat"]
    incoming.discard()
    assert not (store.directory / ".import").exists()


@pytest.mark.parametrize("place", [0, 20, -1])
def test_a_damaged_import_is_refused_whole(store: MapStore, place: int) -> None:
    data = bytearray(exported(store, "flat"))
    data[place] ^= 1
    with pytest.raises(MapStoreError):
        import_all(store, "attic", bytes(data))
    with pytest.raises(MapStoreError, match="arrived damaged"):
        import_all(store, "attic", exported(store, "flat"), sha256="0" * 64)
    assert [entry.name for entry in store.list()] == ["flat"]


def test_pieces_come_in_order_and_no_more_than_was_said(store: MapStore) -> None:
    incoming = Incoming(store, "attic", 100, "")
    incoming.add(0, bytes(40))
    for offset, count in ((0, 10), (50, 10), (40, 61)):
        with pytest.raises(MapStoreError, match="does not follow"):
            incoming.add(offset, bytes(count))
    incoming.discard()


def test_an_existing_name_is_not_taken(store: MapStore) -> None:
    other = replace(made_map("other", seed=9), docks={})
    store.save(other)
    data = exported(store, "other")
    with pytest.raises(MapStoreError, match="exists already"):
        import_all(store, "flat", data)
    assert store.load("flat").docks.keys() == {"home"}
    sha256 = hashlib.sha256(data).hexdigest()
    found = {name: same_content(store, name, sha256) for name in ("other", "flat", "none", "../x")}
    assert found == {"other": True, "flat": False, "none": None, "../x": None}


@pytest.mark.parametrize("total", [0, -1, 10**12])
def test_sizes_that_no_map_has_are_refused(store: MapStore, total: int) -> None:
    with pytest.raises(MapStoreError, match="no map"):
        Incoming(store, "attic", total, "")


def test_a_full_disk_is_told_before_anything_is_written(store: MapStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_transfer, "SPARE_DISK", 10**18)
    with pytest.raises(MapStoreError, match="bytes are free"):
        Incoming(store, "attic", 100, "")
    assert not (store.directory / ".import").exists()
