"""What `tools/reproduce` knows of a table or a figure of the thesis, and what comes of reproducing it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Compared:
    """One printed figure and ours, both as text with their units; `thesis` is "-" where it prints none."""

    what: str
    thesis: str
    ours: str


@dataclass(frozen=True, slots=True)
class Check:
    """One acceptance: what was asked for and by whom ("spec 06, 12.2"), what was found, and whether that is enough."""

    wanted: str
    found: str
    met: bool


@dataclass(frozen=True, slots=True)
class Outcome:
    """Figures side by side, acceptance, and all that a picture is drawn of (plain JSON values)."""

    compared: tuple[Compared, ...]
    checks: tuple[Check, ...]
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Item:
    """One table or figure.

    `name` is what a user types ("table-4.1"); `differs` says which conditions differ from the thesis' and why. `run`
    gets whether to be quick: a few seconds, everything exercised, nothing to be judged by. Items that share a
    measurement share a function under `functools.cache`; it may raise NotPossible. `draw` fills an empty figure from
    `Outcome.data` alone.
    """

    name: str
    title: str
    differs: tuple[str, ...]
    run: Callable[[bool], Outcome]
    draw: Callable[[Mapping[str, Any], Figure], None]


class NotPossible(Exception):
    """What an item needs is not there; the message says what."""


def standard_error(values: NDArray[np.floating]) -> float:
    """Of the mean, which is what the thesis' "±" is; NaN of one value."""
    return float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else math.nan


def written(figure: Figure, path: Path) -> None:
    """As a PNG of a size that a page can show."""
    figure.savefig(path, dpi=80)
