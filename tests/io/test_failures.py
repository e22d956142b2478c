"""The newest failures are kept, the oldest go, and nothing else in the directory is touched."""

from __future__ import annotations

import json
import math
from pathlib import Path

from omnibotd.io.failures import KEPT, FailureStore


def test_report_and_picture_stand_side_by_side(tmp_path: Path) -> None:
    store = FailureStore(tmp_path / "failures")
    assert store.last() is None
    path = store.save({"job": "goto", "error": "LOST", "report": {"confidence": 0.1, "far": math.inf}}, b"\xff\xd8jpeg")
    assert (path.name, path.with_suffix(".jpg").read_bytes()) == ("0001.json", b"\xff\xd8jpeg")
    told = json.loads(path.read_text("utf-8"), parse_constant=lambda text: 1 / 0)  # strict JSON
    assert told == {"job": "goto", "error": "LOST", "report": {"confidence": 0.1, "far": None}, "picture": "0001.jpg"}
    assert FailureStore(tmp_path / "failures").last() == {**told, "file": str(path)}


def test_the_newest_twenty_stay_and_other_peoples_files_too(tmp_path: Path) -> None:
    store = FailureStore(tmp_path)
    notes = [tmp_path / name for name in ("notes.txt", "1.json", "0001.json.bak", "shelf.jpg")]
    for note in notes:
        note.write_text("mine")
    paths = [store.save({"number": number}, b"x" if number % 2 else None) for number in range(KEPT + 7)]
    assert [path.exists() for path in paths] == [False] * 7 + [True] * KEPT
    pictures = [path.with_suffix(".jpg").exists() for path in paths]
    assert pictures == [number >= 7 and number % 2 == 1 for number in range(KEPT + 7)]
    assert [note.read_text() for note in notes] == ["mine"] * len(notes)
    last = store.last()
    assert last is not None
    assert last["number"] == KEPT + 6


def test_a_torn_report_is_passed_over(tmp_path: Path) -> None:
    store = FailureStore(tmp_path)
    sound = store.save({"job": "dock"}, None)
    store.save({"job": "goto"}, None).write_text('{"job": ')
    last = store.last()
    assert last is not None
    assert (last["job"], last["file"]) == ("dock", str(sound))
    assert store.save({"job": "route"}, None).name == "0003.json"
