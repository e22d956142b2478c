"""Pruning in a child process of low priority, as training is: the control loop never waits, and scipy stays out there.

`python -m omnibotd.pruning_process` reads one JSON object from standard input, saves the smaller map, crash-safe, and
answers with {"done": true} or {"error": sentence}.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from omnibotd.core.errors import CoreError, MapError
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.io.map_store import MapStore, MapStoreError

NICENESS = 15  # the robot drives and docks while this runs


def prune_and_save(name: str, nodes: int, store: MapStore) -> TopoMap:
    """Make the stored map smaller. Raises MapError where so few nodes can't cover its floor, MapStoreError."""
    prune = import_module("omnibotd.core.mapping.pruning").prune  # not before: it imports scipy
    pruned: TopoMap = prune(store.load(name), nodes)
    store.save(pruned)
    return pruned


async def prune_in_child(name: str, nodes: int, store: MapStore) -> TopoMap:
    """The same in a child of its own; cancelling ends the child. Raises MapError with the child's sentence."""
    child = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "omnibotd.pruning_process",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    task = {"name": name, "nodes": nodes, "store": str(store.directory)}
    try:
        output, _ = await child.communicate(json.dumps(task).encode())
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    answer: dict[str, Any] = json.loads(output) if output else {}
    if "done" not in answer:
        raise MapError(answer.get("error", f"pruning ended with status {child.returncode}, see the log"))
    return await asyncio.to_thread(store.load, name)


def main() -> int:
    """The child's side."""
    os.nice(NICENESS)
    task = json.load(sys.stdin)
    try:
        prune_and_save(task["name"], task["nodes"], MapStore(Path(task["store"])))
    except (CoreError, MapStoreError) as error:
        print(json.dumps({"error": str(error)}))
        return 1
    print(json.dumps({"done": True}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
