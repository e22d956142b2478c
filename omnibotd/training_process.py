"""Training in a child process of low priority, so that the control loop never waits for it.

The parent starts `python -m omnibotd.training_process` with one JSON object on standard input and reads JSON lines:
progress {"stage", "progress"}, then {"done": true} or {"error": sentence}. The child saves the map itself, crash-safe.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any, cast

from omnibotd.config import MappingConfig
from omnibotd.core.errors import CoreError, TrainingError
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.io.map_format import encode
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.io.recording import RecordingError, teaching_samples
from omnibotd.presets import load_trainer

GROWING = "default"  # the preset whose maps can be added to
LIMITS = MappingConfig()
NICENESS = 15  # the robot drives and docks while this runs; 19 would starve on a busy single core
Progress = Callable[[str, float], None]


def train_and_save(
    recording: Path,
    name: str,
    store: MapStore,
    model: CameraModel,
    progress: Progress,
    preset: str = "default",
    fresh: bool = False,
    limits: MappingConfig = LIMITS,
) -> TopoMap:
    """Teach the map `name` a recording, and save it. Raises CoreError, RecordingError, MapStoreError: nothing changed.

    A recording that the map does not know is added to it; if the map knows it, all its recordings are trained again,
    in order. Places and docks stay. A map of this recording alone is made where there is none, or only a damaged one,
    or one of another preset, or `fresh` says so; another map of that name then stays as NAME-1, NAME-2 ...
    """
    old = _loaded(store, name)
    growing = old if old is not None and not fresh and old.method == preset == GROWING else None
    known = growing.recordings if growing is not None else ()
    if recording.name in known:  # from the beginning, so that no drive counts twice
        made = _taught(None, [recording.with_name(other) for other in known], name, model, progress, preset)
    else:
        made = _taught(growing, [recording], name, model, progress, preset)
    if preset == GROWING:
        made = _within(made, limits)
    if old is not None:  # read again: places may have been named while this took its time
        made = _succeed(store, _loaded(store, name) or old, made)
    store.save(made)
    return made


def _loaded(store: MapStore, name: str) -> TopoMap | None:
    """A damaged map hands on nothing; the store puts it aside."""
    try:
        return store.load(name)
    except MapStoreError:
        return None


def _taught(
    topo_map: TopoMap | None, recordings: Sequence[Path], name: str, model: CameraModel, progress: Progress, preset: str
) -> TopoMap:
    """The map, or none yet, taught one recording after the other."""
    for number, recording in enumerate(recordings):

        def part(stage: str, share: float, before: int = number) -> None:
            progress(stage, (before + share) / len(recordings))

        samples, known = teaching_samples(recording), () if topo_map is None else topo_map.recordings
        if topo_map is None:
            topo_map = load_trainer(preset)(name, samples, model, progress=part)
        else:
            topo_map = _from_mapping("extension", "extend")(topo_map, samples, model, progress=part)
        topo_map = replace(topo_map, recordings=(*known, recording.name))
    assert topo_map is not None, "a map is taught at least one recording"
    return topo_map


def _within(topo_map: TopoMap, limits: MappingConfig) -> TopoMap:
    """Fewer nodes where there are too many, or where the file is too large for the bytes a node takes."""
    prune = _from_mapping("pruning", "prune")
    topo_map = prune(topo_map, limits.max_nodes)
    while (size := len(encode(topo_map))) > limits.max_megabytes * 1e6:  # ends: nodes get fewer until prune refuses
        topo_map = prune(topo_map, int(len(topo_map) * limits.max_megabytes * 1e6 / size))
    return topo_map


def _from_mapping(module: str, function: str) -> Callable[..., TopoMap]:
    """A function of the mapping package that imports scipy, which is for the child only."""
    return cast(Callable[..., TopoMap], getattr(import_module(f"omnibotd.core.mapping.{module}"), function))


def _succeed(store: MapStore, old: TopoMap, made: TopoMap) -> TopoMap:
    """With what the map saved under this name hands on: places and docks, or a place of its own."""
    if set(old.recordings) <= set(made.recordings):
        return replace(made, places=old.places, docks=old.docks)
    names = {entry.name for entry in store.list()}
    store.save(replace(old, name=next(name for k in count(1) if (name := f"{old.name}-{k}") not in names)))
    return made


async def train_in_child(
    recording: Path,
    name: str,
    store: MapStore,
    model: CameraModel,
    progress: Progress,
    preset: str = "default",
    fresh: bool = False,
    limits: MappingConfig = LIMITS,
) -> TopoMap:
    """The same in a child of its own; cancelling ends the child. Raises TrainingError with the child's sentence."""
    child = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "omnibotd.training_process",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    task = {"recording": str(recording), "name": name, "store": str(store.directory), "camera": asdict(model)}
    try:
        await _converse(child, {**task, "preset": preset, "fresh": fresh, "limits": asdict(limits)}, progress)
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    return await asyncio.to_thread(store.load, name)


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
            task["preset"],
            task["fresh"],
            MappingConfig(**task["limits"]),
        )
    except (CoreError, RecordingError, MapStoreError) as error:
        _say(error=str(error))
        return 1
    _say(done=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
