"""One picture of a soak: who commanded, how late, and how much memory it took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quad_mpc_ros.figures import style
from quad_mpc_ros.lie import Array

_RUNGS = ("mpc", "plan", "hover", "blind", "idle", "silent", "waiting")
_WIDTH, _HEIGHT = 10.0, 6.0  # inch
_LATENESS = (0.1, 1e3)  # ms, on the axis


@dataclass(frozen=True, kw_only=True, eq=False)
class SoakSeries:
    """Times [s] from the start; shapes: ``time`` and ``lateness`` [ms] (n,), the memory's (m,).

    ``spans`` are faults by name, from when to when; ``period`` is that of the control [ms].
    """

    time: Array
    sources: Sequence[str]
    lateness: Array
    memory_time: Array
    memory_mb: Array
    spans: Sequence[tuple[str, float, float]]
    period: float


def write_soak_figure(series: SoakSeries, path: Path) -> Path:
    """Draw a soak as PNG and return its path. Raises ``OSError`` when it cannot be written."""
    figure = style.new_figure(_WIDTH, _HEIGHT, dpi=120)
    rungs, late, memory = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    level = np.array([_RUNGS.index(source) for source in series.sources])
    rungs.plot(series.time, level, **style.FLOWN_LINE, drawstyle="steps-post")
    rungs.set_yticks(range(len(_RUNGS)), _RUNGS)
    late.plot(series.time, series.lateness, color=style.FLOWN, linewidth=0.6)
    late.axhline(series.period, **style.BOUND_LINE)
    late.set_yscale("log")
    late.set_ylim(*_LATENESS)
    late.set_ylabel("odometry to tick [ms]", fontsize=9, color=style.INK)
    memory.plot(series.memory_time, series.memory_mb, **style.FLOWN_LINE)
    memory.set_ylabel("memory [MB]", fontsize=9, color=style.INK)
    memory.set_xlabel("time [s]", fontsize=9, color=style.INK)
    for axes in (rungs, late, memory):
        style.tidy(axes)
        for _, begin, end in series.spans:
            axes.axvspan(begin, end, color=style.REFERENCE, alpha=0.25, linewidth=0.0)
    for name, begin, _ in series.spans:
        rungs.text(begin, len(_RUNGS), name, fontsize=5, rotation=90, va="top", ha="right")
    rungs.set_ylim(-0.3, len(_RUNGS))
    style.title(rungs, "Who commanded")
    return style.save(figure, path)
