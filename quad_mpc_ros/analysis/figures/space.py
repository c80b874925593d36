"""What figures in space have in common: the room, the line coloured by speed, the vehicles."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.vehicle import ARM, outline
from quad_mpc_ros.references.course import Course, Gate

_ELEVATION, _AZIMUTH = 22.0, -60.0  # deg, of the eye
_MARGIN = 0.1  # of the longest side of the flight
_MIN_SIDE = 1.0  # m: a hovering flight is not to look like a journey

_MIN_ARM = 0.045  # of the longest side, where the true size could not be seen
_MIN_SEPARATION = 3.6  # arms: nearer to one that is drawn none is drawn

_MIN_SHIFT = 0.05  # m: a gate is drawn again if it was moved by more


def room(points: Array) -> tuple[Array, Array]:
    """Return two corners (3,) [m] of the space round points, down to the ground if it is near."""
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
    """Return axes of that extent, in a place of the figure; Any, for mplot3d has no types."""
    from matplotlib import rc_context
    from matplotlib.ticker import MaxNLocator

    # The colour and the width that mplot3d's grid() is given it ignores; these it takes.
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
        # In space the offset of the ticks would stand on top of the label.
        axis.get_major_formatter().format_ticks(axis.get_majorticklocs())
        offset = axis.get_major_formatter().get_offset()
        axis.get_offset_text().set_visible(False)
        axis.set_label_text(f"{name} [m] {offset}".rstrip(), fontsize=9, color=style.INK)
    return axes


def _corners(axes: Any) -> Array:
    """Return the corners (8, 2) of the room in the plane of the picture."""
    from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped]

    bounds = axes.get_xlim(), axes.get_ylim(), axes.get_zlim()
    x, y, _ = proj3d.proj_transform(
        *np.array(np.meshgrid(*bounds)).reshape(3, -1), axes.get_proj()
    )
    return np.column_stack((x, y))


def drawn_box(figure: Any, axes: Any) -> Any:
    """Return what the room and its labels cover, a box in pixels."""
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()
    box = Bbox.null()
    box.update_from_data_xy(axes.transData.transform(_corners(axes)), ignore=True)
    labels = (axis.get_tightbbox() for axis in (axes.xaxis, axes.yaxis, axes.zaxis))
    return Bbox.union([box, *labels])


def draw_coloured_by_speed(
    figure: Any, axes: Any, p_WB: Array, speed: Array, *, zorder: int
) -> Any:
    """Draw positions (n, 3) [m] as a line coloured by speed (n,) [m/s]; return the axes' scale.

    The line is broken where a position is not a number.
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    pieces = np.stack((p_WB[:-1], p_WB[1:]), axis=1)
    whole = np.isfinite(pieces).all(axis=(1, 2))
    line = Line3DCollection(
        pieces[whole], cmap=_speed_colours(), linewidth=3.0, capstyle="round", zorder=zorder
    )
    line.set_array(speed[1:][whole])
    axes.add_collection(line)
    bar = figure.colorbar(line, ax=axes, shrink=0.55, pad=0.1, aspect=26)
    bar.outline.set_visible(False)
    bar.set_label("speed [m/s]", fontsize=9, color=style.INK)
    bar.ax.tick_params(labelsize=8, labelcolor=style.INK, color=style.FAINT)
    return bar.ax


def _speed_colours() -> Any:
    """Return viridis without its last yellow, which cannot be seen on white."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.92, 256)))


def way_along(p_WB: Array) -> Array:
    """Return the way (n,) [m] to each of positions (n, 3) [m] from the first."""
    steps = np.linalg.norm(np.diff(p_WB, axis=0, prepend=p_WB[:1]), axis=1)
    return np.asarray(np.cumsum(steps))


def draw_vehicles(
    axes: Any,
    p_WB: Array,
    q_WB_xyzw: Array,
    *,
    way: Array,
    spacing: float,
    side: float,
    zorder: int,
    apart: bool = False,
) -> None:
    """Draw the vehicle, four rotors on a cross, at positions (n, 3) [m] as it is tilted there.

    One is drawn every ``spacing`` of the ``way`` (n,), larger than it is where the longest
    ``side`` [m] of the room is large; none on another if they are to be ``apart``.
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    arm = max(ARM, _MIN_ARM * side)
    due = np.flatnonzero(np.diff(np.floor(way / spacing), prepend=0.0))
    drawn = _apart(p_WB, due, distance=_MIN_SEPARATION * arm) if apart else due
    if len(drawn) == 0:
        return
    places = p_WB[drawn]
    R_WB = so3.rotation_from_quaternion_xyzw(q_WB_xyzw[drawn])
    arms_B, rotors_B = outline(arm)
    arms_W = np.einsum("nij,lkj->nlki", R_WB, arms_B) + places[:, None, None]
    rotors_W = np.einsum("nij,lkj->nlki", R_WB, rotors_B) + places[:, None, None]
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
    """Return the corners (n, 3) [m] of all gates of a course; none without one."""
    if course is None:
        return np.zeros((0, 3))
    return np.vstack([gate.corners() for _, gate in drawn_gates(course)])


def drawn_gates(course: Course) -> list[tuple[int, Gate]]:
    """Return the gates of a course with their numbers, once for each place where they stood."""
    drawn: list[tuple[int, Gate]] = []
    for number, gate in sorted(zip(course.numbers, course.gates, strict=True), key=_number):
        stood = [other for own, other in drawn if own == number]
        if not any(_are_together(gate, other) for other in stood):
            drawn.append((number, gate))
    return drawn


def _number(numbered: tuple[int, Gate]) -> int:
    return numbered[0]


def _are_together(one: Gate, other: Gate) -> bool:
    return float(np.abs(one.corners() - other.corners()).max()) < _MIN_SHIFT


def draw_gates(axes: Any, course: Course | None, *, zorder: int) -> None:
    """Draw the openings of a course's gates, with their numbers; nothing without a course."""
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


def _apart(p_WB: Array, places: Iterable[int], *, distance: float) -> list[int]:
    """Return those of the places whose positions are no nearer to each other than that [m]."""
    kept: list[int] = []
    for place in places:
        if not kept or np.linalg.norm(p_WB[kept] - p_WB[place], axis=1).min() >= distance:
            kept.append(int(place))
    return kept
