"""Times of one thread's own work, and where within a call they go."""

from __future__ import annotations

import gc
import inspect
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import wraps
from importlib import import_module
from typing import Any
from unittest import mock

import numpy as np

# Processor time of this thread: what others on the machine do costs nothing here but cold caches.
clock = time.thread_time_ns


@dataclass
class Times:
    """Durations in ns of what was done again and again, by name; in the order first measured."""

    samples: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))

    def measure(self, name: str, work: Callable[[], Any]) -> Any:
        """Do the work once and note what it took; returns what the work returned."""
        began = clock()
        result = work()
        self.samples[name].append(clock() - began)
        return result

    def note(self, spent: Mapping[str, int]) -> None:
        for name, duration in spent.items():
            self.samples[name].append(duration)

    def median(self, name: str) -> float:
        return float(np.median(self.samples[name]))

    def table(self) -> dict[str, dict[str, float]]:
        """Median and minimum in ms, by name."""
        return {
            name: {"median_ms": float(np.median(taken)) / 1e6, "minimum_ms": min(taken) / 1e6}
            for name, taken in self.samples.items()
        }


def settle() -> None:
    """Let the garbage collector forget what was built so far: nobody's cycle shall pay for another's tables."""
    gc.collect()
    gc.freeze()


class Tracer:
    """While entered, notes the time that calls of some functions take, less that of traced calls inside them.

    `stages` names each stage's functions as MODULE:NAME or MODULE:CLASS.NAME; they are wrapped from outside.
    """

    def __init__(self, stages: Mapping[str, Iterable[str]]) -> None:
        self._stages = stages
        self._inside: list[int] = []
        self._patches = ExitStack()
        self._spent = dict.fromkeys(stages, 0)

    def __enter__(self) -> Tracer:
        for stage, functions in self._stages.items():
            for function in functions:
                owner, name = _located(function)
                self._patches.enter_context(mock.patch.object(owner, name, self._timed(stage, owner, name)))
        return self

    def __exit__(self, *error: object) -> None:
        self._patches.close()

    def of(self, work: Callable[[], Any]) -> dict[str, int]:
        """Nanoseconds by stage of doing the work once."""
        self._spent = dict.fromkeys(self._stages, 0)
        work()
        return self._spent

    def _timed(self, stage: str, owner: Any, name: str) -> Any:
        function = getattr(owner, name)

        @wraps(function)
        def timed(*arguments: Any, **options: Any) -> Any:
            self._inside.append(0)
            began = clock()
            try:
                return function(*arguments, **options)
            finally:
                taken = clock() - began
                self._spent[stage] += taken - self._inside.pop()
                if self._inside:
                    self._inside[-1] += taken

        return staticmethod(timed) if isinstance(inspect.getattr_static(owner, name), staticmethod) else timed


def _located(function: str) -> tuple[Any, str]:
    """The module or class that holds the function, and its name there."""
    module, _, path = function.partition(":")
    owner: Any = import_module(module)
    *classes, name = path.split(".")
    for part in classes:
        owner = getattr(owner, part)
    return owner, name
