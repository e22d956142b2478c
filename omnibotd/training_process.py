"""Training in a child process of low priority, so that the control loop never waits for it.

The parent starts `python -m omnibotd.training_process` with one JSON object on standard input and reads JSON lines:
progress {"stage", "progress"}, then {"done": true} or {"error": sentence}. The child saves the map itself, crash-safe.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path
from typing import Any

from omnibotd.core.errors import CoreError, TrainingError
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.mapping.training import train
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.io.recording import RecordingError, teaching_samples

NICENESS = 15  # the robot drives and docks while this runs; 19 would starve on a busy single core
Progress = Callable[[str, float], None]


def train_and_save(recording: Path, name: str, store: MapStore, model: CameraModel, progress: Progress) -> TopoMap:
    """Make a map from a recording and save it. Raises TrainingError, RecordingError, MapStoreError.

    A map of the same recording hands on its places and docks; one of another recording stays, as NAME-1, NAME-2 ...
    """
    fresh = train(name, teaching_samples(recording), model, progress=progress)
    fresh = replace(fresh, recordings=(recording.name,))
    names = {entry.name for entry in store.list() if entry.bytes}
    if name in names:
        fresh = _succeed(store, fresh, names)
    store.save(fresh)
    return fresh


def _succeed(store: MapStore, fresh: TopoMap, names: set[str]) -> TopoMap:
    """What the map saved under this name hands on. A damaged one hands on nothing; the store puts it aside."""
    try:
        old = store.load(fresh.name)
    except MapStoreError:
        return fresh
    if old.recordings == fresh.recordings:
        return replace(fresh, places=old.places, docks=old.docks)
    store.save(replace(old, name=next(name for k in count(1) if (name := f"{fresh.name}-{k}") not in names)))
    return fresh


async def train_in_child(
    recording: Path, name: str, store: MapStore, model: CameraModel, progress: Progress
) -> TopoMap:
    """The same in a child of its own; cancelling ends the child. Raises TrainingError with the child's sentence."""
    child = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "omnibotd.training_process",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    try:
        await _converse(child, _task(recording, name, store, model), progress)
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    return await asyncio.to_thread(store.load, name)


def _task(recording: Path, name: str, store: MapStore, model: CameraModel) -> dict[str, Any]:
    return {"recording": str(recording), "name": name, "store": str(store.directory), "camera": asdict(model)}


async def _converse(child: asyncio.subprocess.Process, task: dict[str, Any], progress: Progress) -> None:
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write(json.dumps(task).encode() + b"\n")
    child.stdin.close()
    done = False
    async for line in child.stdout:
        message = json.loads(line)
        if "error" in message:
            raise TrainingError(message["error"])
        done = done or "done" in message
        if "stage" in message:
            progress(message["stage"], message["progress"])
    status = await child.wait()
    if not done:
        raise TrainingError(f"the training process ended with status {status} before it was done, see the log")


def _say(**message: Any) -> None:
    print(json.dumps(message), flush=True)


def main() -> int:
    """The child's side."""
    os.nice(NICENESS)
    task = json.loads(sys.stdin.readline())
    camera = task["camera"]
    camera = {key: tuple(value) if isinstance(value, list) else value for key, value in camera.items()}
    try:
        train_and_save(
            Path(task["recording"]),
            task["name"],
            MapStore(Path(task["store"])),
            CameraModel(**camera),
            lambda stage, share: _say(stage=stage, progress=round(share, 3)),
        )
    except (CoreError, RecordingError, MapStoreError) as error:
        _say(error=str(error))
        return 1
    _say(done=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
