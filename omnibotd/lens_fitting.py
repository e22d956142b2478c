"""Fits the lens in a child process, `python -m omnibotd.lens_calibration`: it takes seconds and much memory."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from omnibotd.core.calibration.chessboard import Board
from omnibotd.core.errors import CoreError


class FittingError(CoreError):
    """Pictures from which no lens can be had; the sentence says what to do."""


LensFitter = Callable[[Sequence[bytes], Board], Awaitable[dict[str, Any]]]
"""(JPEGs, board) to camera_info. Raises FittingError."""


async def fit_in_child(jpegs: Sequence[bytes], board: Board) -> dict[str, Any]:
    """The lens that took these pictures of a board, as camera_info. Cancelling ends the child. Raises FittingError."""
    with TemporaryDirectory(prefix="omnibot-lens-") as folder:
        await asyncio.to_thread(_write, Path(folder), jpegs)
        out = Path(folder) / "camera.yaml"
        child = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "omnibotd.lens_calibration",
            *("--images", folder, "--board", str(board), "--square", str(board.square), "--out", str(out), "--json"),
            stdout=asyncio.subprocess.PIPE,
        )
        try:
            output, _ = await child.communicate()
        finally:
            if child.returncode is None:
                child.kill()
                await child.wait()
        return _result(output, out, child.returncode)


def _write(folder: Path, jpegs: Sequence[bytes]) -> None:
    for number, jpeg in enumerate(jpegs, 1):
        (folder / f"{number:03}.jpg").write_bytes(jpeg)


def _result(output: bytes, out: Path, status: int | None) -> dict[str, Any]:
    """What the child wrote, or its sentence."""
    lines = [json.loads(line) for line in output.splitlines() if line.startswith(b"{")]
    errors = [str(line["error"]) for line in lines if "error" in line]
    if status != 0 or not out.exists():
        raise FittingError(errors[-1] if errors else f"the fit ended with status {status}, see the log")
    info: dict[str, Any] = yaml.safe_load(out.read_text("utf-8"))
    return info
