"""The results as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from tools.benchmark.cycle import DECODING, DEFAULT, LITERAL, ORB
from tools.benchmark.docking import MOST
from tools.benchmark.scale import BRUTE_FORCE, BUCKETS, CYCLE
from tools.benchmark.slow_pc_report import slow_pc_lines

Result = Mapping[str, Any]
_NAME = 58


def as_text(result: Result) -> str:
    """Tables of what was measured."""
    parts = {
        "cycle": _cycle,
        "scale": _scale,
        "som": _som,
        "docking": _docking,
        "decoding": _decoding,
        "quota": slow_pc_lines,
    }
    return "\n".join(line for name, lines in parts.items() if name in result for line in lines(result[name]))


def _cycle(result: Result) -> Iterator[str]:
    yield f"From a picture of {result['jpeg_bytes'] / 1e3:.0f} KB to a velocity, {result['nodes']} nodes, ms"
    yield f"{'':{_NAME}}{'median':>9}{'least':>9}{'x decoding':>12}{'x default':>12}"
    for name, row in result["contestants"].items():
        times = f"{row['median_ms']:9.3f}{row['minimum_ms']:9.3f}"
        yield f"{name:{_NAME}}{times}{row['of_decoding']:12.2f}{row['of_default']:12.2f}"
    for name, stages in result["stages"].items():
        yield f"\nWhere it goes: {name} (watching adds about a tenth)"
        for stage, row in stages.items():
            yield f"  {stage:{_NAME - 2}}{row['median_ms']:9.3f}{row['minimum_ms']:9.3f}"
    yield ""
    yield from _judged(result["contestants"])


def _judged(rows: Result) -> Iterator[str]:
    ours = rows[DEFAULT]
    yield f"at most 4 x {DECODING}: {_word(ours['of_decoding'] <= 4.0)} ({ours['of_decoding']:.2f})"
    yield f"cheaper than {ORB}: {_word(rows[ORB]['of_default'] > 1.0)} ({1.0 / rows[ORB]['of_default']:.2f})"
    times = rows[LITERAL]["of_default"]
    yield f"at least 20 x cheaper than the literal method: {_word(times >= 20.0)} ({times:.1f})\n"


def _scale(result: Result) -> Iterator[str]:
    searches = (CYCLE, BUCKETS, BRUTE_FORCE)
    yield "With the number of nodes: median ms, and MB beside the map's own"
    yield f"{'nodes':>10}" + "".join(f"{name:>24}" for name in searches) + f"{'index':>10}{'map':>10}"
    for size, row in result["sizes"].items():
        times = "".join(f"{row[name]['median_ms']:24.3f}" for name in searches)
        yield f"{size:>10}{times}{row['index_bytes'] / 1e6:10.1f}{row['map_bytes'] / 1e6:10.1f}"
    growth = result["growth"]
    yield f"{'growth':>10}" + "".join(f"{growth[name]:23.2f}x" for name in searches)
    yield f"from {growth['from']} to {growth['to']} under 3 x: {_word(growth[CYCLE] < 3.0)} ({growth[CYCLE]:.2f})\n"


def _som(result: Result) -> Iterator[str]:
    yield f"Training a SOM of {result['units']} units with {result['samples']} samples of {result['features']} features"
    yield f"{'':{_NAME}}{'seconds':>9}{'x ours':>9}{'quantisation':>14}{'topographic':>13}{'seeds':>7}"
    for name, row in result["trainers"].items():
        times = f"{row['seconds']:9.3f}{row['of_ours']:9.1f}"
        errors = f"{row['quantisation_error']:14.3f}{row['topographic_error']:13.3f}"
        yield f"{name:{_NAME}}{times}{errors}{row['seeds']:7d}"


def _docking(result: Result) -> Iterator[str]:
    yield f"\nOne docking estimate from a picture of {result['jpeg_bytes'] / 1e3:.0f} KB, ms"
    yield f"{'':{_NAME}}{'median':>9}{'least':>9}{'x decoding':>12}"
    rows = result["contestants"]
    for name, row in rows.items():
        yield f"{name:{_NAME}}{row['median_ms']:9.3f}{row['minimum_ms']:9.3f}{row['of_decoding']:12.2f}"
    for name, stages in result["stages"].items():
        yield f"\nWhere it goes: {name} (watching adds a little)"
        for stage, row in stages.items():
            yield f"  {stage:{_NAME - 2}}{row['median_ms']:9.3f}{row['minimum_ms']:9.3f}"
    yield ""
    for name, most in MOST.items():
        times = rows[name]["of_decoding"]
        yield f"{name}: at most {most:.0f} x {DECODING}: {_word(times <= most)} ({times:.1f})"


def _decoding(result: Result) -> Iterator[str]:
    times = ", ".join(f"{size} {row['median_ms']:.3f} ms" for size, row in result["decoding"].items())
    yield f"\nDecoding a JPEG to grey, by size: {times}"
    yield f"{'errors, mm':{_NAME}}{'median':>9}{'95 %':>9}"
    shares = {"reduced": f"1/{result['reduction']}", "half": "1/2", "whole": "whole"}
    for what in ("places", "docking"):
        for name, row in result[what].items():
            yield f"{what + ', decoded ' + shares[name]:{_NAME}}{row['median_mm']:9.2f}{row['p95_mm']:9.2f}"


def _word(good: bool) -> str:
    return "yes" if good else "NO"
