# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parts of figures in space: axes, line coloured by speed, vehicles, gates."""

from __future__ import annotations

from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.vehicle import ARM, outline
from quad_mpc_ros.references.course import Course, Gate

_ELEVATION, _AZIMUTH = 22.0, -60.0  # deg, of the camera
_MARGIN = 0.1  # of the longest side
_MIN_SIDE = 1.0  # m, so that drift in hover does not fill the figure

_MIN_ARM = 0.045  # of the longest side, where the true size would be invisible
_VEHICLE_COUNT = 14
_TURN_WEIGHT = 0.12  # distance per radian of rotation, as a share of the longest side
_MIN_SPACING = 1e-3  # m, between two vehicles

_MIN_SHIFT = 0.05  # m: a gate is drawn again if it was moved by more


def room(points: Array) -> tuple[Array, Array]:
    """Return two corners (3,) [m] of a box around points, including a ground that is near."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    widened = np.maximum(_MIN_SIDE - (upper - lower), 0.0) / 2.0
    side = max(float(np.max(upper - lower)), _MIN_SIDE)
    near_ground = 0.0 <= lower[2] <= side
    lower, upper = lower - widened - _MARGIN * side, upper + widened + _MARGIN * side
    if near_ground:
        lower[2] = 0.0
    return lower, upper


def draw_room(
    figure: Any, lower: Array, upper: Array, *, place: Any = 111, zoom: float = 1.0
) -> Any:
    """Return 3D axes between two corners at a position of the figure; mplot3d has no types."""
    from matplotlib import rc_context
    from matplotlib.ticker import MaxNLocator

    # mplot3d ignores colour and width of grid(), but uses these.
    with rc_context({"grid.color": style.GRID, "grid.linewidth": 0.6}):
        axes = figure.add_subplot(place, projection="3d", computed_zorder=False)
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_box_aspect(upper - lower, zoom=zoom)
    names = {"x, east": axes.xaxis, "y, north": axes.yaxis, "z, up": axes.zaxis}
    for name, axis in names.items():
        axis.set_pane_color((0.98, 0.98, 0.98, 1.0))
        axis.line.set_color(style.FAINT)
        axis.set_tick_params(labelsize=8, labelcolor=style.INK, color=style.FAINT)
        axis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))
        # The offset text of the ticks would overlap the label.
        axis.get_major_formatter().format_ticks(axis.get_majorticklocs())
        offset = axis.get_major_formatter().get_offset()
        axis.get_offset_text().set_visible(False)
        axis.set_label_text(f"{name} [m] {offset}".rstrip(), fontsize=9, color=style.INK)
    return axes


def top_of(axes: Any) -> float:
    """Return the height of the drawn box in 3D axes, as a share of the height of the axes."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform  # type: ignore[import-untyped]

    corners = np.meshgrid(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())
    x, y, _ = proj_transform(*(side.ravel() for side in corners), axes.get_proj())
    to_axes = axes.transData - axes.transAxes
    return float(to_axes.transform(np.column_stack((x, y)))[:, 1].max())


def draw_coloured_by_speed(
    figure: Any, axes: Any, p_WB: Array, speed: Array, *, zorder: int
) -> None:
    """Draw positions (n, 3) [m] as a line coloured by speed (n,) [m/s], with the colour bar.

    The line is interrupted where a position is not a number.
    """
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    # Viridis without its lightest yellow, which is invisible on white.
    colours = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.92, 256)))
    pieces = np.stack((p_WB[:-1], p_WB[1:]), axis=1)
    whole = np.isfinite(pieces).all(axis=(1, 2))
    line = Line3DCollection(
        pieces[whole], cmap=colours, linewidth=3.0, capstyle="round", zorder=zorder
    )
    line.set_array(speed[1:][whole])
    axes.add_collection(line)
    bar = figure.colorbar(line, ax=axes, shrink=0.55, pad=0.1, aspect=26)
    bar.outline.set_visible(False)
    bar.set_label("speed [m/s]", fontsize=9, color=style.INK)
    bar.ax.tick_params(labelsize=8, labelcolor=style.INK, color=style.FAINT)


def draw_vehicles(axes: Any, p_WB: Array, q_WB_xyzw: Array, *, side: float, zorder: int) -> None:
    """Draw the vehicle, four rotors on a cross, at some of positions (n, 3) [m] along a path.

    The vehicles are evenly spaced in distance and rotation. Vehicles are enlarged if the longest
    ``side`` [m] of the axes is large.
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    R_WB = so3.rotation_from_quaternion_xyzw(q_WB_xyzw)
    turns = so3.log(np.swapaxes(R_WB[:-1], -1, -2) @ R_WB[1:])
    steps = np.linalg.norm(np.diff(p_WB, axis=0), axis=1)
    steps += _TURN_WEIGHT * side * np.linalg.norm(turns, axis=1)
    spacing = max(float(steps.sum()) / _VEHICLE_COUNT, _MIN_SPACING)
    passed = np.floor(np.append(0.0, np.cumsum(steps)) / spacing)
    drawn = np.flatnonzero(np.diff(passed, prepend=-1.0))  # with one at the start
    places = p_WB[drawn]
    arms_B, rotors_B = outline(max(ARM, _MIN_ARM * side))
    arms_W = np.einsum("nij,lkj->nlki", R_WB[drawn], arms_B) + places[:, None, None]
    rotors_W = np.einsum("nij,lkj->nlki", R_WB[drawn], rotors_B) + places[:, None, None]
    axes.add_collection(
        Poly3DCollection(
            rotors_W.reshape(-1, *rotors_W.shape[2:]),
            facecolors=(*style.rgb(style.INK), 0.18),
            edgecolors=style.INK,
            linewidths=0.6,
            zorder=zorder,
        )
    )
    axes.add_collection(
        Line3DCollection(arms_W.reshape(-1, 2, 3), color=style.INK, linewidth=1.2, zorder=zorder)
    )


def gate_points(course: Course | None) -> Array:
    """Return the corners (n, 3) [m] of all gates; none without a course."""
    if course is None:
        return np.zeros((0, 3))
    return np.vstack([gate.corners() for _, gate in drawn_gates(course)])


def drawn_gates(course: Course) -> list[tuple[int, Gate]]:
    """Return the gates of a course with their numbers, once for each position."""
    drawn: list[tuple[int, Gate]] = []
    for number, gate in sorted(
        zip(course.numbers, course.gates, strict=True), key=lambda numbered: numbered[0]
    ):
        stood = [other.corners() for own, other in drawn if own == number]
        if all(np.abs(gate.corners() - other).max() >= _MIN_SHIFT for other in stood):
            drawn.append((number, gate))
    return drawn


def draw_gates(axes: Any, course: Course | None, *, zorder: int) -> None:
    """Draw the openings of a course's gates, with their numbers; a course is optional."""
    if course is None:
        return
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.5, foreground="white")]
    for place, (number, gate) in enumerate(drawn_gates(course)):
        corners = gate.corners()
        label = None if place else "gate"
        axes.plot(*corners.T, color=style.BOUND, linewidth=1.6, label=label, zorder=zorder)
        axes.text(
            *corners[corners[:, 2].argmax()],
            f" {number}",
            color=style.BOUND,
            fontsize=9,
            fontweight="bold",
            verticalalignment="bottom",
            path_effects=halo,
            zorder=zorder,
        )
