"""The compiled firmware on a bench. FIRMWARE_SOURCES names other sources: that is how the mutants are tested."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tools.avr import building
from tools.avr.bench import Bench
from tools.avr.boards import BOARDS

SOURCES = Path(os.environ.get("FIRMWARE_SOURCES", building.SOURCES))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Without compiler or simulator these tests can't run; they say what to install."""
    here = Path(__file__).parent
    packages = building.missing()
    if packages:
        skip = pytest.mark.skip(reason=f"needs: apt-get install {' '.join(packages)}")
        for item in items:
            if here in item.path.parents:
                item.add_marker(skip)


@pytest.fixture
def make_bench() -> Iterator[Callable[[str], Bench]]:
    """Makes benches by the name of their board, and clears them away."""
    with ExitStack() as stack:
        yield lambda board: stack.enter_context(Bench(BOARDS[board], building.firmware(board, SOURCES)))


@pytest.fixture
def bench(make_bench: Callable[[str], Bench]) -> Bench:
    """An Uno, powered up, hands not shaken."""
    return make_bench("uno")


@pytest.fixture(params=sorted(BOARDS))
def any_bench(request: pytest.FixtureRequest, make_bench: Callable[[str], Bench]) -> Bench:
    """Each of the boards."""
    return make_bench(request.param)
