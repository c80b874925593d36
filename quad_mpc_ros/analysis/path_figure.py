"""The flight in space."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.analysis import style
from quad_mpc_ros.analysis.flight import Flight
from quad_mpc_ros.analysis.waypoints import waypoints
from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import Array

_WIDTH, _HEIGHT = 8.0, 6.2  # inch
_ELEVATION, _AZIMUTH = 22.0, -60.0  # deg, of the eye
_ZOOM = 1.12
_MARGIN = 0.1  # of the longest side of the flight
_SMALLEST_SIDE = 1.0  # m: a hovering flight is not to look like a journey
_MOST_NUMBERS = 12  # waypoints; numbers on more would hide the flight

_ARM = 0.11  # m, from the centre to a rotor: the paper's 220 mm diagonal
_SMALLEST_ARM = 0.045  # of the longest side, where the true size could not be seen
_SPACING = 0.25  # of the longest side, flown between two drawn vehicles
_ROTOR_POINTS = 24

# From the ground up; mplot3d's own order takes each of these as a whole and gets it wrong.
_GROUND, _REFERENCE, _FLIGHT, _VEHICLES, _MARKS = 1, 2, 3, 4, 5


def write_path(flight: Flight, path: Path) -> Path:
    """Draw the flight coloured by its speed, with start, waypoints and reference.

    The vehicle, four rotors on a cross, is drawn along the way as it was tilted there, larger
    than it is where the room is large. Raises ``OSError`` when the file cannot be written.
    """
    figure = style.new_figure(_WIDTH, _HEIGHT)
    # Any: mplot3d has no type hints.
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    lower, upper = _room(flight)
    _draw_room(axes, lower, upper)
    _draw_reference(axes, flight)
    _draw_flight(figure, axes, flight, ground=float(lower[2]))
    _draw_vehicles(axes, flight, side=float(np.max(upper - lower)))
    axes.legend(
        loc="upper left", frameon=False, fontsize=9, labelcolor=style.INK, handlelength=2.4
    )
    return style.save(figure, path)


def _room(flight: Flight) -> tuple[Array, Array]:
    """Return two corners of the space to draw (3,) [m], down to the ground when it is near."""
    points = flight.p_WB
    if flight.reference is not None:
        points = np.vstack((points, flight.reference.p_WB))
    lower, upper = points.min(axis=0), points.max(axis=0)
    widened = np.maximum(_SMALLEST_SIDE - (upper - lower), 0.0) / 2.0
    side = max(float(np.max(upper - lower)), _SMALLEST_SIDE)
    near_ground = 0.0 <= lower[2] <= side
    lower, upper = lower - widened - _MARGIN * side, upper + widened + _MARGIN * side
    if near_ground:
        lower[2] = 0.0
    return lower, upper


def _draw_room(axes: Any, lower: Array, upper: Array) -> None:
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    axes.set_box_aspect(upper - lower, zoom=_ZOOM)
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    names = {"x, east": axes.xaxis, "y, north": axes.yaxis, "z, up": axes.zaxis}
    for name, axis in names.items():
        axis.set_pane_color((0.98, 0.98, 0.98, 1.0))
        axis.line.set_color(style.FAINT)
        axis.set_label_text(f"{name} [m]", fontsize=9, color=style.INK)
        axis.set_tick_params(labelsize=8, labelcolor=style.INK, color=style.FAINT)
        axis.set_major_locator(_few_ticks())
        # The only way in mplot3d: its grid() ignores colour and width.
        axis._axinfo["grid"].update(color=style.GRID, linewidth=0.6)


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=5, steps=[1, 2, 5, 10])


def _draw_reference(axes: Any, flight: Flight) -> None:
    from matplotlib.patheffects import withStroke

    if flight.reference is None:
        return
    axes.plot(
        *flight.reference.p_WB.T,
        color=style.REFERENCE,
        linewidth=1.6,
        linestyle=(0, (4, 2)),
        label="reference",
        zorder=_REFERENCE,
    )
    places = list(dict.fromkeys(tuple(waypoint.p_WB.tolist()) for waypoint in waypoints(flight)))
    if not places:
        return
    axes.scatter(
        *np.transpose(places),
        s=80,
        facecolors="none",
        edgecolors=style.BOUND,
        linewidths=1.8,
        depthshade=False,
        label="waypoint",
        zorder=_MARKS,
    )
    halo = [withStroke(linewidth=3.0, foreground="white")]
    for number, place in enumerate(places[:_MOST_NUMBERS], start=1):
        axes.text(
            *place,
            f"  {number}  ",
            fontsize=10,
            fontweight="bold",
            color=style.BOUND,
            horizontalalignment="right",
            verticalalignment="top",
            path_effects=halo,
            zorder=_MARKS,
        )


def _draw_flight(figure: Any, axes: Any, flight: Flight, *, ground: float) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    x, y, _ = flight.p_WB.T
    axes.plot(x, y, ground, color=style.FAINT, linewidth=1.0, zorder=_GROUND)
    axes.scatter(
        *flight.p_WB[0],
        marker="s",
        s=36,
        color=style.INK,
        depthshade=False,
        label="start",
        zorder=_MARKS,
    )
    pieces = np.stack((flight.p_WB[:-1], flight.p_WB[1:]), axis=1)
    line = Line3DCollection(
        pieces, cmap=_speed_colours(), linewidth=3.0, capstyle="round", zorder=_FLIGHT
    )
    line.set_array(np.linalg.norm(flight.v_WB_B[1:], axis=1))
    axes.add_collection(line)
    bar = figure.colorbar(line, ax=axes, shrink=0.55, pad=0.1, aspect=26)
    bar.outline.set_visible(False)
    bar.set_label("speed [m/s]", fontsize=9, color=style.INK)
    bar.ax.tick_params(labelsize=8, labelcolor=style.INK, color=style.FAINT)


def _speed_colours() -> Any:
    """Return viridis without its last yellow, which cannot be seen on white."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.92, 256)))


def _draw_vehicles(axes: Any, flight: Flight, *, side: float) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    steps = np.linalg.norm(np.diff(flight.p_WB, axis=0, prepend=flight.p_WB[:1]), axis=1)
    drawn = np.flatnonzero(np.diff(np.floor(np.cumsum(steps) / (_SPACING * side)), prepend=0.0))
    if len(drawn) == 0:
        return
    p_WB = flight.p_WB[drawn]
    R_WB = so3.rotation_from_quaternion_xyzw(flight.q_WB_xyzw[drawn])
    arms_B, rotors_B = _vehicle(max(_ARM, _SMALLEST_ARM * side))
    arms_W = np.einsum("nij,lkj->nlki", R_WB, arms_B) + p_WB[:, None, None]
    rotors_W = np.einsum("nij,lkj->nlki", R_WB, rotors_B) + p_WB[:, None, None]
    axes.add_collection(
        Poly3DCollection(
            rotors_W.reshape(-1, _ROTOR_POINTS, 3),
            facecolors=(*style.rgb(style.INK), 0.18),
            edgecolors=style.INK,
            linewidths=0.6,
            zorder=_VEHICLES,
        )
    )
    axes.add_collection(
        Line3DCollection(
            arms_W.reshape(-1, 2, 3), color=style.INK, linewidth=1.2, zorder=_VEHICLES
        )
    )


def _vehicle(arm: float) -> tuple[Array, Array]:
    """Return the two beams (2, 2, 3) and the four rotors (4, points, 3) in the body frame [m]."""
    directions = np.radians([45.0, 135.0, 225.0, 315.0])
    hubs = arm * np.column_stack((np.cos(directions), np.sin(directions), np.zeros(4)))
    turn = np.linspace(0.0, 2.0 * np.pi, _ROTOR_POINTS, endpoint=False)
    disc = 0.6 * arm * np.column_stack((np.cos(turn), np.sin(turn), np.zeros(_ROTOR_POINTS)))
    return hubs[[[0, 2], [1, 3]]], hubs[:, None] + disc
