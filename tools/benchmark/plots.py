"""The results as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tools.benchmark.cycle import DEFAULT
from tools.benchmark.docking import MOST
from tools.benchmark.scale import BRUTE_FORCE, BUCKETS, CYCLE

INK, FAINT = "#20507a", "#b0b0b0"


def draw(result: Mapping[str, Any], path: Path) -> None:
    """One panel for each part that was measured."""
    panels = {"cycle": (_contestants, _stages), "scale": (_growth,), "som": (_som,), "docking": (_docking,)}
    wanted = [(draw_panel, result[part]) for part, drawn in panels.items() if part in result for draw_panel in drawn]
    figure = Figure(figsize=(5.5 * len(wanted), 4.2), layout="constrained")
    for axes, (draw_panel, part) in zip(figure.subplots(1, len(wanted), squeeze=False)[0], wanted, strict=True):
        draw_panel(axes, part)
    figure.savefig(path, dpi=110)


def _contestants(axes: Axes, cycle: Mapping[str, Any]) -> None:
    rows = cycle["contestants"]
    names = list(rows)[::-1]
    axes.barh(
        names, [rows[name]["of_decoding"] for name in names], color=[INK if n == DEFAULT else FAINT for n in names]
    )
    axes.axvline(4.0, color=INK, linestyle=":")
    axes.set(xscale="log", xlabel="times the grey decoding of the picture", title="a cycle")


def _stages(axes: Axes, cycle: Mapping[str, Any]) -> None:
    stages = cycle["stages"][DEFAULT]
    names = list(stages)[::-1]
    axes.barh(names, [stages[name]["median_ms"] for name in names], color=INK)
    axes.set(xlabel="ms", title=f"stages, {cycle['nodes']} nodes")


def _growth(axes: Axes, scale: Mapping[str, Any]) -> None:
    sizes = [int(size) for size in scale["sizes"]]
    for name, colour, style in ((CYCLE, INK, "-"), (BUCKETS, FAINT, "-"), (BRUTE_FORCE, FAINT, ":")):
        times = [row[name]["median_ms"] for row in scale["sizes"].values()]
        axes.loglog(sizes, times, marker="o", color=colour, linestyle=style, label=name)
    axes.set(xlabel="nodes", ylabel="ms", title="growth")
    axes.legend()


def _docking(axes: Axes, docking: Mapping[str, Any]) -> None:
    rows = docking["contestants"]
    names = list(rows)[::-1]
    colours = [INK if name in MOST else FAINT for name in names]
    axes.barh(names, [rows[name]["of_decoding"] for name in names], color=colours)
    axes.set(xscale="log", xlabel="times the grey decoding of the picture", title="a docking estimate")


def _som(axes: Axes, som: Mapping[str, Any]) -> None:
    for name, row in som["trainers"].items():
        axes.plot(row["quantisation_error"], row["topographic_error"], "o", color=INK if name == "ours" else FAINT)
        axes.annotate(
            f"{name}: {row['seconds']:.2g} s", (row["quantisation_error"], row["topographic_error"]), fontsize=7
        )
    axes.set(xlabel="quantisation error", ylabel="topographic error", title="training the SOM")
