"""A reference before it is flown: its path, and what it needs against the limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import space, style
from quad_mpc_ros.analysis.figures.over_time import draw_panel, label_time
from quad_mpc_ros.analysis.figures.panels import Curve, Panel
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.course import Course
from quad_mpc_ros.references.feasibility import Feasibility
from quad_mpc_ros.references.trajectory import TrajectorySamples

_WIDTH, _HEIGHT = 10.0, 4.6  # inch
_ZOOM = 0.85
_VEHICLE_COUNT = 14  # vehicles along the way
_TURN_WEIGHT = 0.12  # of the longest side: the way that a turn by a radian counts for
_MIN_SPACING = 1e-3  # m, between two vehicles
_MAX_POINTS = 1500
_START, _PATH, _VEHICLES = 4, 2, 3


def write_reference(
    title: str,
    samples: TrajectorySamples,
    verdict: Feasibility,
    path: Path,
    *,
    course: Course | None = None,
    dpi: int = 150,
) -> None:
    """Draw a reference, sampled along its whole way, its gates, and the verdict on it.

    Raises ``OSError`` when the file cannot be written.
    """
    figure = style.new_figure(_WIDTH, _HEIGHT, dpi=dpi)
    grid = figure.add_gridspec(5, 2, width_ratios=(1.15, 1.0))
    _draw_path(figure, grid[:, 0], samples, course)
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
    else:  # at rest, or from place to place by jumps
        axes.plot(*p_WB.T, color=style.FAINT, linewidth=1.2, zorder=_PATH)
    side = float(np.max(upper - lower))
    way = space.way_along(p_WB) + _TURN_WEIGHT * side * _turned(q_WB_xyzw)
    spacing = max(float(way[-1]) / _VEHICLE_COUNT, _MIN_SPACING)
    space.draw_vehicles(
        axes,
        p_WB,
        q_WB_xyzw,
        way=way + spacing,  # with one at the start
        spacing=spacing,
        side=side,
        zorder=_VEHICLES,
    )
    space.draw_gates(axes, course, zorder=_START)
    axes.scatter(
        *p_WB[0], marker="s", s=30, color=style.INK, depthshade=False, label="start", zorder=_START
    )


def _turned(q_WB_xyzw: Array) -> Array:
    """Return the angle (n,) [rad] turned up to each attitude."""
    R_WB = so3.rotation_from_quaternion_xyzw(q_WB_xyzw)
    steps = np.linalg.norm(so3.log(np.swapaxes(R_WB[:-1], -1, -2) @ R_WB[1:]), axis=1)
    return np.asarray(np.append(0.0, np.cumsum(steps)))


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
