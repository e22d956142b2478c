"""The verbs that write and read files of the person who says them: `map plot`, `map export` and `map import`."""

from __future__ import annotations

import argparse
import base64
import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from omnibotd import cli_output
from omnibotd.cli_verbs import Params, Terminal, UsageError
from omnibotd.control_client import RemoteError
from omnibotd.control_protocol import JOB_FAILED
from omnibotd.core.error_name import ErrorName

PIECE = 32 * 1024  # bytes of a map sent at once; as base64 three quarters of the longest request


def plot(terminal: Terminal, options: argparse.Namespace) -> None:
    """The file's name says which kind of picture it is."""
    kind = "svg" if (options.output or "").lower().endswith(".svg") else "png"
    params = {"map": options.map, "format": "svg" if kind == "svg" else None}
    result = terminal.ask("map.plot", params, "drawing")
    target = options.output or f"{result.get('map') or options.map or 'map'}.png"
    with _whole(target) as file:
        file.write(base64.b64decode(result[kind], validate=True))
    terminal.show({"map": result.get("map"), "file": target}, f"wrote {target}")


def export(terminal: Terminal, options: argparse.Namespace) -> None:
    """Fetch the map's file piece by piece; all from one version of it, or none."""
    target = options.output or f"{options.map}.omap"
    params: Params = {"map": options.map, "offset": 0}
    with _whole(target) as file:
        while True:
            piece = terminal.ask("map.export", params, f"exporting {options.map}")
            file.write(base64.b64decode(piece["data"], validate=True))
            params = {"map": options.map, "offset": file.tell(), "version": piece["version"]}
            terminal.live.show(f"exporting {options.map}: {file.tell() / piece['bytes']:.0%}")
            if file.tell() >= piece["bytes"] or not piece["data"]:
                break
    terminal.live.clear()
    result = {"map": options.map, "file": target, "bytes": piece["bytes"]}
    terminal.show(result, f"wrote {target}, {cli_output.size(piece['bytes'])}")


def import_map(terminal: Terminal, options: argparse.Namespace) -> None:
    """Send a file piece by piece; the map gets its name when the daemon has read all of it."""
    name = options.name or Path(options.file).stem
    if not name.replace("-", "").replace("_", "").isalnum() or not name.isascii():
        raise UsageError(f"map import: {name!r} can't name a map: say --name NAME (letters, digits, - and _)")
    with _telling(options.file), open(options.file, "rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        total = file.tell()
        file.seek(0)
        while True:
            params = {"map": name, "offset": file.tell(), "bytes": total, "sha256": sha256}
            data = base64.b64encode(file.read(PIECE)).decode()
            result = terminal.ask("map.import", {**params, "data": data}, f"importing {name}")
            terminal.live.show(f"importing {name}: {result['received'] / total:.0%}")
            if result["received"] >= total:
                break
    terminal.live.clear()
    terminal.show(result, _imported(result))


def _imported(result: Params) -> str:
    name = result["map"]
    if result.get("unchanged"):
        return f"map {name} is here already, with the same content"
    return f"imported as {name}, {result['nodes']} nodes; to use it say map use {name}"


@contextlib.contextmanager
def _whole(target: str) -> Iterator[BinaryIO]:
    """A file that gets its name when it is written whole; what stood there before stays until then."""
    part = f"{target}.part"
    with _telling(target):
        try:
            with open(part, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, target)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(part)
            raise


@contextlib.contextmanager
def _telling(name: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise RemoteError(JOB_FAILED, ErrorName.STORAGE, f"{name}: {error.strerror or error}") from error
