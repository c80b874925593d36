"""The measurements as a picture: step time by peer, and against the length of the horizon."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.experiments.bench.page import compared, swept, swept_peers

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH, _HEIGHT = 10.0, 3.6  # inch
_COLOURS = (style.FLOWN, style.BOUND, style.REFERENCE)


def write_picture(result: Mapping[str, Any], path: Path) -> Path:
    """Draw a result into a PNG; raises ``OSError`` when it cannot be written."""
    figure = style.new_figure(_WIDTH, _HEIGHT)
    left, *right = figure.subplots(1, 2 if swept(result) else 1, squeeze=False)[0]
    _draw_peers(left, result)
    for axes in right:
        _draw_horizons(axes, result)
    return style.save(figure, path)


def _draw_peers(axes: Axes, result: Mapping[str, Any]) -> None:
    """Draw p50 to p99 as a bar and the maximum as a dot, whole step and solver alone."""
    style.tidy(axes)
    shown = compared(result)[::-1]
    for row, entry in enumerate(shown):
        for offset, times, colour, label in (
            (0.15, entry["step_us"], style.FLOWN, "whole step"),
            (-0.15, entry["solve_us"], style.REFERENCE, "solver's own time"),
        ):
            if times["p50"]:
                axes.plot(
                    [times["p50"], times["p99"]],
                    [row + offset] * 2,
                    color=colour,
                    linewidth=5.0,
                    label=label if row == 0 else None,
                )
                axes.plot([times["max"]], [row + offset], ".", color=colour)
    titles = [result["peers"][entry["peer"]]["title"].replace(", ", ",\n") for entry in shown]
    axes.set_yticks(range(len(shown)), titles)
    axes.set_xscale("log")
    axes.set_xlabel("p50 to p99, dot: max [us]", fontsize=9, color=style.INK)
    style.title(axes, f"N = {result['settings']['horizon_steps']}")
    style.legend(axes)


def _draw_horizons(axes: Axes, result: Mapping[str, Any]) -> None:
    style.tidy(axes)
    for peer, colour in zip(swept_peers(result), itertools.cycle(_COLOURS), strict=False):
        entries = [entry for entry in swept(result) if entry["peer"] == peer]
        if not entries:
            continue
        steps = [entry["horizon_steps"] for entry in entries]
        for times, line, what in (("step_us", "o-", ""), ("solve_us", "o:", ", solver alone")):
            axes.plot(
                steps,
                [entry[times]["p50"] for entry in entries],
                line,
                color=colour,
                linewidth=1.3,
                markersize=4.0,
                label=f"{peer}{what}",
            )
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("steps N of the horizon", fontsize=9, color=style.INK)
    axes.set_ylabel("p50 [us]", fontsize=9, color=style.INK)
    axes.legend(frameon=False, fontsize=8, labelcolor=style.INK)
    style.title(axes, "Against N")
