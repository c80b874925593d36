# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a flight in space."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import obstacles, space, style
from quad_mpc_ros.recordings.evaluation.race import drawn_course
from quad_mpc_ros.recordings.evaluation.waypoints import waypoint_positions
from quad_mpc_ros.recordings.flight import Flight

_WIDTH, _HEIGHT = 8.0, 6.5  # inch
_MAX_NUMBERED = 12  # waypoints; more numbers would hide the flight
_MAX_SEGMENTS = 20_000  # of the coloured line, which are drawn one by one

# From the ground up, because the order that mplot3d chooses is wrong.
_GROUND, _OBSTACLES, _REFERENCE, _FLIGHT, _VEHICLES, _MARKS = range(1, 7)


def write_path(flight: Flight, path: Path) -> Path:
    """Draw the flight coloured by speed, with vehicles, reference, waypoints, gates and obstacles.

    Raises ``OSError`` if the file cannot be written.
    """
    figure = style.new_figure(_WIDTH, _HEIGHT)
    points = [flight.p_WB, *([] if flight.reference is None else [flight.reference.p_WB])]
    shapes = obstacles.drawn_shapes(flight)
    course = drawn_course(flight)
    extents = obstacles.extent(shapes), space.gate_points(course)
    lower, upper = space.room(np.vstack([*points, *extents]))
    axes = space.draw_room(figure, lower, upper)
    obstacles.draw(axes, shapes, zorder=_OBSTACLES)
    _draw_reference(axes, flight)
    if course is None:
        _draw_waypoints(axes, flight)
    _draw_flight(figure, axes, flight, ground=float(lower[2]))
    space.draw_gates(axes, course, zorder=_MARKS)
    side = float(np.max(upper - lower))
    space.draw_vehicles(axes, flight.p_WB, flight.q_WB_xyzw, side=side, zorder=_VEHICLES)
    style.legend(axes, above=space.top_of(axes))
    return style.save(figure, path, cropped=True)


def _draw_reference(axes: Any, flight: Flight) -> None:
    if flight.reference is None:
        return
    axes.plot(
        *flight.broken(flight.time, flight.reference.p_WB)[1].T,
        color=style.REFERENCE,
        linewidth=1.6,
        linestyle=(0, (4, 2)),
        label="reference",
        zorder=_REFERENCE,
    )


def _draw_waypoints(axes: Any, flight: Flight) -> None:
    from matplotlib.patheffects import withStroke

    places = waypoint_positions(flight)
    if flight.reference is None or not len(places):
        return
    axes.scatter(
        *places.T,
        s=80,
        facecolors="none",
        edgecolors=style.BOUND,
        linewidths=1.8,
        depthshade=False,
        label="waypoint",
        zorder=_MARKS,
    )
    halo = [withStroke(linewidth=3.0, foreground="white")]
    for number, place in enumerate(places[:_MAX_NUMBERED], start=1):
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
    x, y, _ = flight.broken(flight.time, flight.p_WB)[1].T
    axes.plot(x, y, ground, color=style.FAINT, linewidth=1.0, zorder=_GROUND)
    start = flight.p_WB[0]
    axes.scatter(
        *start, marker="s", s=36, color=style.INK, depthshade=False, label="start", zorder=_MARKS
    )
    thinned = slice(None, None, -(-len(x) // _MAX_SEGMENTS))
    speed = np.linalg.norm(flight.v_WB_B[thinned], axis=1)
    _, p_WB, speed = flight.broken(flight.time[thinned], flight.p_WB[thinned], speed)
    space.draw_coloured_by_speed(figure, axes, p_WB, speed, zorder=_FLIGHT)
