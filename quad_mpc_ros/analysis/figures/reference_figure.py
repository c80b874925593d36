# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a reference: path, throttle and body rates compared with the limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import space, style
from quad_mpc_ros.analysis.figures.over_time import draw_panel, label_time
from quad_mpc_ros.analysis.figures.panels import Curve, Panel
from quad_mpc_ros.references.course import Course
from quad_mpc_ros.references.feasibility import Feasibility
from quad_mpc_ros.references.trajectory import TrajectorySamples

_WIDTH, _HEIGHT = 10.0, 4.6  # inch
_ZOOM = 0.85
_MAX_POINTS = 1500
_START, _PATH, _VEHICLES = 4, 2, 3


def write_reference(
    title: str,
    verdict: Feasibility,
    path: Path,
    *,
    course: Course | None = None,
    dpi: int = 150,
) -> None:
    """Draw a reference with gates, and the required throttle and rates with their limits.

    Args:
        title: The title of the figure.
        verdict: Samples along the whole reference, required throttle and rates, limits.
        path: The file to write.
        course: The gates, if there are any.
        dpi: Resolution [1/inch].

    Raises:
        OSError: The file cannot be written.
    """
    figure = style.new_figure(_WIDTH, _HEIGHT, dpi=dpi)
    grid = figure.add_gridspec(5, 2, width_ratios=(1.15, 1.0))
    _draw_path(figure, grid[:, 0], verdict.samples, course)
    _draw_needs(figure, [figure.add_subplot(grid[row, 1]) for row in range(5)], verdict)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=style.INK, fontweight="bold")
    style.save(figure, path)


def _draw_path(figure: Any, place: Any, samples: TrajectorySamples, course: Course | None) -> None:
    thinned = slice(None, None, max(len(samples.p_WB) // _MAX_POINTS, 1))
    p_WB, q_WB_xyzw = samples.p_WB[thinned], samples.q_WB_xyzw[thinned]
    lower, upper = space.room(np.vstack((p_WB, space.gate_points(course))))
    axes = space.draw_room(figure, lower, upper, place=place, zoom=_ZOOM)
    speed = np.linalg.norm(samples.v_WB_W[thinned], axis=1)
    if speed.max() > 0.0:
        space.draw_coloured_by_speed(figure, axes, p_WB, speed, zorder=_PATH)
    else:  # at rest, or jumps between places
        axes.plot(*p_WB.T, color=style.FAINT, linewidth=1.2, zorder=_PATH)
    side = float(np.max(upper - lower))
    space.draw_vehicles(axes, p_WB, q_WB_xyzw, side=side, zorder=_VEHICLES)
    space.draw_gates(axes, course, zorder=_START)
    axes.scatter(
        *p_WB[0], marker="s", s=30, color=style.INK, depthshade=False, label="start", zorder=_START
    )


def _draw_needs(figure: Any, column: list[Any], verdict: Feasibility) -> None:
    needs, limits = verdict.over_time, verdict.limits
    throttle = (limits.throttle_min, limits.throttle_max)
    rows = [
        ("throttle", "", "", needs.throttle, throttle),
        *(
            ("ω", axis, "rad/s", rates, (-bound, bound))
            for axis, rates, bound in zip("xyz", needs.w_WB_B.T, limits.rate_limits, strict=True)
        ),
        ("height", "", "m", needs.height, (0.0,)),
    ]
    for axes, (name, subscript, unit, values, bounds) in zip(column, rows, strict=True):
        panel = Panel(
            name=name,
            subscript=subscript,
            unit=unit,
            curves=[Curve(name="needed", time=needs.seconds, values=values)],
            bounds=bounds,
            bound_name="limit",
        )
        draw_panel(axes, panel, fontsize=8)
    for axes in column[:-1]:
        axes.tick_params(labelbottom=False)
    style.legend(column[0])
    label_time(column[-1])
    figure.align_ylabels(column)
