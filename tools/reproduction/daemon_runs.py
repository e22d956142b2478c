"""Experiments of `tools/evaluate` with the whole daemon, for the tables that are made of them."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any

from tools.evaluation.__main__ import main as evaluate
from tools.reproduction.item import NotPossible


@dataclass(frozen=True, slots=True)
class Course:
    """A world as of `--world`, its seed, the preset, and for how many seconds it is taught."""

    world: str
    seed: int
    preset: str
    teach: float


def evaluated(experiment: str, course: Course, runs: int, options: Sequence[str] = ()) -> dict[str, Any]:
    """What `tools/evaluate` writes. Raises NotPossible.

    What was taught is kept in the folder of temporary files, so that experiments with one map teach it once.
    """
    said = io.StringIO()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "result.json"
        kept = Path(gettempdir()) / "omnibotd-reproduce"
        where = {"world": course.world, "seed": course.seed, "preset": course.preset, "teach": course.teach}
        given = {**where, "runs": runs, "json": path, "keep": kept}
        arguments = [experiment, *(text for name, value in given.items() for text in (f"--{name}", str(value)))]
        with redirect_stdout(said), redirect_stderr(said):
            status = evaluate([*arguments, *options])
        if status:
            raise NotPossible(said.getvalue().strip().splitlines()[-1])
        result: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return result
