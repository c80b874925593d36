"""The flight in space."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import obstacles, space, style
from quad_mpc_ros.recordings.evaluation.race import drawn_course
from quad_mpc_ros.recordings.evaluation.waypoints import waypoint_positions
from quad_mpc_ros.recordings.flight import Flight

_SIDE = 8.0  # inch, before the figure is cropped to what is drawn
_SCALE_HEIGHT = 0.6  # of the height of what is drawn
_MARGIN = 0.1  # inch
_MAX_NUMBERED = 12  # waypoints; numbers on more would hide the flight

_VEHICLE_SPACING = 0.25  # of the longest side, flown between two drawn vehicles
_MAX_VEHICLES = 300
_MAX_SEGMENTS = 20_000  # of the coloured line, each drawn by itself

# From the ground up; mplot3d's own order takes each of these as a whole and gets it wrong.
_GROUND, _OBSTACLES, _REFERENCE, _FLIGHT, _VEHICLES, _MARKS = range(1, 7)


def write_path(flight: Flight, path: Path) -> Path:
    """Draw the flight coloured by its speed, with start, waypoints and reference.

    The vehicle, four rotors on a cross, is drawn along the way as it was tilted there, larger
    than it is where the room is large. Raises ``OSError`` when the file cannot be written.
    """
    figure = style.new_figure(_SIDE, _SIDE)
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
    scale = _draw_flight(figure, axes, flight, ground=float(lower[2]))
    space.draw_gates(axes, course, zorder=_MARKS)
    side = float(np.max(upper - lower))
    way = space.way_along(flight.p_WB)
    space.draw_vehicles(
        axes,
        flight.p_WB,
        flight.q_WB_xyzw,
        way=way,
        spacing=max(_VEHICLE_SPACING * side, float(way[-1]) / _MAX_VEHICLES),
        side=side,
        zorder=_VEHICLES,
        apart=True,
    )
    return style.save(figure, path, crop=_arrange(figure, axes, scale))


def _arrange(figure: Any, axes: Any, scale: Any) -> Any:
    """Put the legend above what is drawn and the scale beside it; return the box of all [inch]."""
    from matplotlib.transforms import Bbox

    room = space.drawn_box(figure, axes)
    figure.set_layout_engine("none")
    drawn, bar = room.transformed(figure.transFigure.inverted()), scale.get_position()
    height = _SCALE_HEIGHT * drawn.height
    bottom = drawn.y0 + 0.5 * (drawn.height - height)
    scale.set_position((drawn.x1 + bar.width, bottom, bar.width, height))
    handles, labels = axes.get_legend_handles_labels()
    legend = figure.legend(
        handles,
        labels,
        loc="lower left",
        bbox_to_anchor=(drawn.x0, drawn.y1),
        ncols=len(labels),
        frameon=False,
        fontsize=9,
        labelcolor=style.INK,
        handlelength=2.4,
    )
    boxes = Bbox.union([room, legend.get_window_extent(), scale.get_tightbbox()])
    return boxes.transformed(figure.dpi_scale_trans.inverted()).padded(_MARGIN)


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


def _draw_flight(figure: Any, axes: Any, flight: Flight, *, ground: float) -> Any:
    x, y, _ = flight.broken(flight.time, flight.p_WB)[1].T
    axes.plot(x, y, ground, color=style.FAINT, linewidth=1.0, zorder=_GROUND)
    start = flight.p_WB[0]
    axes.scatter(
        *start, marker="s", s=36, color=style.INK, depthshade=False, label="start", zorder=_MARKS
    )
    thinned = slice(None, None, -(-len(x) // _MAX_SEGMENTS))
    speed = np.linalg.norm(flight.v_WB_B[thinned], axis=1)
    _, p_WB, speed = flight.broken(flight.time[thinned], flight.p_WB[thinned], speed)
    return space.draw_coloured_by_speed(figure, axes, p_WB, speed, zorder=_FLIGHT)
