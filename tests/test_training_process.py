"""What `train` makes of the recordings of a map: a first map, a larger one, the same again, or a fresh one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from omnibotd import training_process
from omnibotd.config import MappingConfig
from omnibotd.core.errors import MapError, TrainingError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.drive import TeachingSample
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.io.map_store import MapStore
from omnibotd.training_process import LIMITS, train_and_save
from tests.teaching import CAMERA, waypoint_drive
from tools.sim import ceilings

FIRST, SECOND, STRANGE = "room.0001.mcap", "room.0002.mcap", "room.0003.mcap"


@pytest.fixture(scope="module")
def drives() -> dict[str, list[TeachingSample]]:
    rooms = {FIRST: (11, 1), SECOND: (11, 2), STRANGE: (14, 3)}
    made = {name: waypoint_drive(ceilings.tiles(room), 25.0, 0.7, seed) for name, (room, seed) in rooms.items()}
    return {name: drive.samples for name, drive in made.items()}


@pytest.fixture
def store(tmp_path: Path, drives: dict[str, list[TeachingSample]], monkeypatch: pytest.MonkeyPatch) -> MapStore:
    def samples(path: Path) -> Iterator[TeachingSample]:
        return iter(drives[path.name])

    monkeypatch.setattr(training_process, "teaching_samples", samples)
    return MapStore(tmp_path)


def teach(store: MapStore, recording: str, fresh: bool = False, limits: MappingConfig = LIMITS) -> TopoMap:
    path, shares = store.directory / "recordings" / recording, [0.0]
    made = train_and_save(
        path, "room", store, CAMERA, lambda _, share: shares.append(share), fresh=fresh, limits=limits
    )
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    return made


def furnished(store: MapStore) -> TopoMap:
    """The first map, with a place in it."""
    store.save(teach(store, FIRST).with_place("desk", Pose2D(0.2, 0.1, 0.0)))
    return store.load("room")


def names(store: MapStore) -> set[str]:
    return {entry.name for entry in store.list()}


def test_a_new_recording_is_added(store: MapStore) -> None:
    before = furnished(store)
    made = teach(store, SECOND)
    assert made.recordings == (FIRST, SECOND)
    assert made.sessions.max() == 1
    np.testing.assert_array_equal(made.poses[: len(before)], before.poses)
    assert made.places == before.places
    assert names(store) == {"room"}
    np.testing.assert_allclose(store.load("room").poses, made.poses, atol=1e-3)


def test_the_only_recording_is_trained_again(store: MapStore) -> None:
    before = furnished(store)
    made = teach(store, FIRST)
    assert (made.recordings, made.places, len(made)) == ((FIRST,), before.places, len(before))
    assert names(store) == {"room"}


def test_one_of_several_recordings_means_all_of_them_again(store: MapStore) -> None:
    furnished(store)
    grown = teach(store, SECOND)
    again = teach(store, SECOND)
    assert (again.recordings, again.places) == (grown.recordings, grown.places)
    np.testing.assert_allclose(again.poses, grown.poses, atol=0.01)


def test_a_fresh_map_leaves_the_old_one_beside_it(store: MapStore) -> None:
    before = furnished(store)
    made = teach(store, SECOND, fresh=True)
    assert (made.recordings, made.places) == ((SECOND,), {})
    assert names(store) == {"room", "room-1"}
    assert store.load("room-1").places == before.places


def test_a_drive_elsewhere_is_refused_and_changes_nothing(store: MapStore) -> None:
    before = furnished(store)
    with pytest.raises(TrainingError, match="--fresh"):
        teach(store, STRANGE)
    assert store.load("room").recordings == before.recordings
    assert names(store) == {"room"}


def test_a_map_of_another_preset_is_not_added_to(store: MapStore) -> None:
    store.save(replace(furnished(store), method="other"))
    assert teach(store, SECOND).recordings == (SECOND,)
    assert store.load("room-1").method == "other"


def test_a_damaged_map_is_put_aside(store: MapStore) -> None:
    furnished(store)
    path = store.directory / "room.omap"
    path.write_bytes(path.read_bytes()[:-9])
    assert teach(store, SECOND).recordings == (SECOND,)
    assert (store.directory / "room.omap.damaged").exists()


def test_maps_keep_to_their_limits(store: MapStore) -> None:
    whole = len(teach(store, FIRST))
    assert len(teach(store, FIRST, limits=MappingConfig(max_nodes=whole - 10))) == whole - 10
    size = (store.directory / "room.omap").stat().st_size
    made = teach(store, FIRST, limits=MappingConfig(max_megabytes=(size - 1000) / 1e6))
    assert len(made) < whole - 10
    assert (store.directory / "room.omap").stat().st_size <= size - 1000
    with pytest.raises(MapError, match="needed to cover"):
        teach(store, FIRST, limits=MappingConfig(max_nodes=3))
