"""What the daemon did on a slow PC, as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from tools.benchmark.slow_pc import MOST_MEMORY, NODES, ON_TIME

Result = Mapping[str, Any]


def slow_pc_lines(result: Result) -> Iterator[str]:
    """Tables, then whether it kept its time and its memory."""
    pc = result["slow_pc"]
    yield f"A PC of the Atom N270 class: {pc['share']:.0%} of a core, the loop takes {1e3 * pc['seconds']:.0f} ms"
    yield f"(no real N270 was measured). From start to the first answer: {result['start_seconds']:.1f} s\n"
    yield f"{'':10}{'minutes':>9}{'ticks/s':>9}{'late':>7}{'on time':>10}{'worst':>9}{'memory':>10}   of a core here"
    for row in result["stretches"]:
        yield from _stretch(row)
    for what, stages in result["stages"].items():
        yield f"\nWhere a cycle of {what} goes, ms of that PC"
        for stage, spent in stages.items():
            yield f"  {stage:30}{spent:9.1f}"
    yield from _judged(result["stretches"])


def _stretch(row: Result) -> Iterator[str]:
    ticks = f"{row['seconds'] / 60:9.1f}{row['rate_hz']:9.2f}{row['late_ticks']:7d}{row['on_time']:10.3%}"
    shares = ", ".join(f"{name} {share:.1%}" for name, share in row["threads"].items())
    yield f"{row['what']:10}{ticks}{row['late_ms_max']:6.0f} ms{row['memory_mb']:7.0f} MB   {shares}"
    grown = ", ".join(f"{before:g} to {after:g} {name}" for name, (before, after) in row["held"].items())
    yield f"{'':10}from beginning to end: {grown}"
    for end in row["ends"]:
        yield f"{'':10}begun anew after: {end}"


def _judged(rows: list[Result]) -> Iterator[str]:
    late, ticks = sum(row["late_ticks"] for row in rows), sum(row["ticks"] for row in rows)
    memory = max(row["memory_mb"] for row in rows)
    yield f"\nticks on time, at least {ON_TIME:.1%}: {_word(1.0 - late / ticks >= ON_TIME)} ({1.0 - late / ticks:.3%})"
    yield f"memory, at most {MOST_MEMORY:.0f} MB with {NODES} nodes: {_word(memory <= MOST_MEMORY)} ({memory:.0f})"


def _word(good: bool) -> str:
    return "yes" if good else "NO"
