"""Bytes from nowhere into everything that parses: no exception, bounded memory, and back in step at the next frame."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.system.fuzz_targets import KINDS, TARGETS, Target, check_recovery, noise, pieces

BLOCKS = st.lists(
    st.tuples(st.sampled_from(KINDS), st.integers(0, 2**32), st.integers(1, 16384)), min_size=1, max_size=12
)
NAMES = [target.name for target in TARGETS]


def fuzz(target: Target, goal: int) -> None:
    """At least `goal` bytes, in examples of about 50 kB or half of that, by the version; the same ones each time."""
    fed = 0

    @settings(derandomize=True, max_examples=goal // 5_000 + 1, deadline=None, database=None)
    @given(BLOCKS, st.integers(0, 2**32))
    def run(blocks: list[tuple[str, int, int]], seed: int) -> None:
        nonlocal fed
        if fed >= goal:
            return
        feed, parser = target.make()
        for kind, block_seed, size in blocks:
            data = noise(kind, block_seed, size, target.valid)
            fed += len(data)
            for piece in pieces(data, seed):
                feed(piece)
            if target.holds is not None:
                assert len(pickle.dumps(parser)) <= target.memory
        check_recovery(target, feed)

    run()
    assert fed >= goal


@pytest.mark.parametrize("target", TARGETS, ids=NAMES)
def test_a_little_noise(target: Target) -> None:
    fuzz(target, 100_000)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("target", TARGETS, ids=NAMES)
def test_ten_million_bytes(target: Target) -> None:
    fuzz(target, 10_000_000)


COVERAGE_GUIDED = """
import sys
sys.path[:] = {paths!r}
import atheris
with atheris.instrument_imports(include=["firmware_bridge", "omnibotd.control_protocol"]):
    from tests.system.fuzz_targets import TARGETS, check_recovery
(target,) = [target for target in TARGETS if target.name == {name!r}]
def one(data):
    feed, _ = target.make()
    feed(data)
    check_recovery(target, feed)
atheris.Setup(["fuzz", "-runs=100000", "-max_len=4096", "-seed=1", "-rss_limit_mb=1024", "-timeout=10"], one)
atheris.Fuzz()
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", NAMES)
def test_coverage_guided(name: str, tmp_path: Path) -> None:
    """By atheris, where it is installed: it has no wheel for every machine, so it is none of our requirements."""
    pytest.importorskip("atheris")
    script = COVERAGE_GUIDED.format(paths=[str(Path(__file__).parents[2]), *sys.path], name=name)
    ended = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=800, check=False
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert "Done 100000 runs" in ended.stderr, ended.stderr[-2000:]
