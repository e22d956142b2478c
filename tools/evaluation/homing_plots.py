"""Pictures of single estimates as the thesis' figures 7.7 to 7.9 show them, one column a method."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tools.evaluation.homing import FARTHEST, METRIC, NEAR, Errors
from tools.evaluation.plots import BAD, FAINT, GOOD


def draw_homing(
    errors: Mapping[str, Errors], summaries: Mapping[str, Mapping[str, Any]], title: str, path: Path
) -> None:
    """Errors of the turn (7.7), estimated against true distance (7.8), homing component (7.9)."""
    rows = (_turns, _turns_by_distance, _distances, _components_by_distance, _components)
    figure = Figure(figsize=(4.2 * len(errors), 2.6 * len(rows)), layout="constrained")
    figure.suptitle(title)
    panels = figure.subplots(len(rows), len(errors), squeeze=False)
    for column, (name, some) in enumerate(errors.items()):
        panels[0, column].set_title(f"{name}: {some.refused} of {summaries[name]['n']} frames refused", fontsize=9)
        for row, draw in enumerate(rows):
            draw(panels[row, column], some, summaries[name], METRIC[name])
    figure.savefig(path, dpi=90)


def _turns(axes: Axes, errors: Errors, summary: Mapping[str, Any], metric: bool) -> None:
    axes.hist(errors.turn, bins=np.arange(-182.0, 183.0, 4.0), color=GOOD)
    axes.set(yscale="symlog", xlabel="error of the turn (°)", ylabel="frames", xlim=(-182.0, 182.0))
    if "turn" in summary:
        turn = summary["turn"]
        text = f"{turn['mean_deg']:.2f} ± {turn['sd_deg']:.2f}°\n{turn['gross']} beyond 30°"
        axes.text(0.02, 0.95, text, transform=axes.transAxes, va="top", fontsize=8)


def _turns_by_distance(axes: Axes, errors: Errors, summary: Mapping[str, Any], metric: bool) -> None:
    axes.plot(errors.distance, errors.turn, ".", color=GOOD, markersize=2)
    axes.set(xlim=(0.0, FARTHEST), ylim=(-185.0, 185.0), xlabel="distance (m)", ylabel="error of the turn (°)")


def _distances(axes: Axes, errors: Errors, summary: Mapping[str, Any], metric: bool) -> None:
    axes.axvspan(0.0, NEAR, color=FAINT, alpha=0.3, linewidth=0)
    axes.plot(errors.distance, errors.length, ".", color=GOOD, markersize=2)
    if "distance" in summary:
        line, ends = summary["distance"], np.array([0.0, FARTHEST])
        label = f"residual {100 * line['sd_m']:.1f} cm within 1 m"
        axes.plot(ends, line["slope"] * ends + line["intercept"], color=BAD, linewidth=1, label=label)
        axes.legend(fontsize=8, frameon=False, loc="upper left")
    top = 2.0 if metric else 200.0
    axes.set(xlim=(0.0, FARTHEST), ylim=(0.0, top), xlabel="distance (m)")
    axes.set_ylabel("estimated distance (m)" if metric else "image distance (px)")


def _components_by_distance(axes: Axes, errors: Errors, summary: Mapping[str, Any], metric: bool) -> None:
    axes.plot(errors.distance, errors.component, ".", color=GOOD, markersize=2)
    axes.set(xlim=(0.0, FARTHEST), ylim=(-1.05, 1.05), xlabel="distance (m)", ylabel="homing component")


def _components(axes: Axes, errors: Errors, summary: Mapping[str, Any], metric: bool) -> None:
    axes.hist(errors.component[np.isfinite(errors.component)], bins=np.linspace(-1.0, 1.0, 41), color=GOOD)
    axes.set(yscale="symlog", xlim=(-1.05, 1.05), xlabel="homing component", ylabel="frames")
    if "component" in summary:
        text = f"median {summary['component']['median']:.4f}"
        axes.text(0.02, 0.95, text, transform=axes.transAxes, va="top", fontsize=8)
