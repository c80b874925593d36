"""The flight in space as a Plotly figure, with what the controller expected at each time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import obstacles, space, style
from quad_mpc_ros.analysis.report.plotting import FAR, lay_out, plotly, subplots
from quad_mpc_ros.analysis.report.run import MOST_HORIZONS, ReportedRun
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.evaluation.race import drawn_course
from quad_mpc_ros.recordings.evaluation.waypoints import waypoint_positions
from quad_mpc_ros.recordings.flight import Flight

MOST_POINTS = 5000  # of a line in space
_HORIZON_COLOUR = "#CC79A7"
_HEIGHT = 560  # pixels
_HOVER = "t = %{customdata:.2f} s<br>x %{x:.3f}, y %{y:.3f}, z %{z:.3f} m"


def space_figure(runs: Sequence[ReportedRun]) -> Any:
    """Return path, reference, waypoints and predicted horizons of runs beside each other."""
    scenes = [[{"type": "scene"}] * len(runs)]
    figure = subplots(1, runs, titles="subplot_titles", specs=scenes, horizontal_spacing=0.01)
    fastest = max(float(_speed(run).max()) for run in runs)
    for column, run in enumerate(runs, start=1):
        for trace in _traces(run, fastest=fastest, first=column == 1):
            figure.add_trace(trace, row=1, col=column)
    lower, upper = _room(runs)
    # WebGL draws in single precision, in which UTM coordinates are half a metre apart.
    origin = np.where(np.abs(lower) >= FAR, np.round(lower, -3), 0.0)
    for trace in figure.data:
        for name, shift in zip("xyz", origin, strict=True):
            trace[name] = (np.asarray(trace[name], dtype=np.float64) - shift).astype(np.float32)
    figure.update_scenes(**_scene(lower - origin, upper - origin, origin))
    lay_out(figure, height=_HEIGHT, margin={"l": 0, "r": 0, "b": 0})
    return figure


def drawn_horizons(flight: Flight) -> tuple[Array, Array]:
    """Return positions (n, 3) and times (n,) of evenly chosen plans, apart by rows of NaN."""
    step = -(-len(flight.plans) // MOST_HORIZONS) or 1
    plans = flight.plans[::step]
    if not plans:
        return np.zeros((0, 3)), np.zeros(0)
    gap = np.full((1, 3), np.nan)
    stamps_ns = np.array([plan.stamp_ns for plan in plans], dtype=np.int64)
    lengths = [len(plan.p_WB) + 1 for plan in plans]
    positions = np.vstack([part for plan in plans for part in (plan.p_WB, gap)])
    return positions, np.repeat(flight.time_of(stamps_ns), lengths)


def _room(runs: Sequence[ReportedRun]) -> tuple[Array, Array]:
    """Return the corners (3,) [m] of a box about all runs."""
    points = [run.flight.p_WB for run in runs]
    points += [space.gate_points(drawn_course(run.flight)) for run in runs]
    points += [run.flight.reference.p_WB for run in runs if run.flight.reference is not None]
    points += [obstacles.extent(obstacles.drawn_shapes(run.flight)) for run in runs]
    return space.room(np.vstack(points))


def _scene(lower: Array, upper: Array, origin: Array) -> dict[str, Any]:
    """Return the layout of a scene, the same for all runs, in which a metre is a metre.

    Corners (3,) [m] are relative to an origin (3,), which the titles of the axes name.
    """
    sides = (upper - lower) / float(np.max(upper - lower))
    axes = {
        f"{name}axis": {
            "title": {"text": f"{name} - {shift:.0f} [m]" if shift else f"{name} [m]"},
            "range": [low, high],
        }
        for name, low, high, shift in zip("xyz", lower, upper, origin.tolist(), strict=True)
    }
    return {
        **axes,
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", sides.tolist(), strict=True)),
        "camera": {"eye": {"x": -1.15, "y": -1.4, "z": 0.85}, "center": {"z": -0.12}},
    }


def _traces(run: ReportedRun, *, fastest: float, first: bool) -> list[Any]:
    flight = run.flight
    horizons, horizon_time = drawn_horizons(flight)
    traces = [
        _line("predicted", horizons, horizon_time, colour=_HORIZON_COLOUR, width=2, legend=first)
    ]
    thinned = slice(None, None, -(-len(flight.p_WB) // MOST_POINTS))
    time = flight.time[thinned]
    if flight.reference is not None:
        at, reference = flight.broken(time, flight.reference.p_WB[thinned])
        places = waypoint_positions(flight)
        traces += [
            _line("reference", reference, at, colour=style.REFERENCE, width=4, legend=first),
            _marks("waypoint", places, colour=style.BOUND, symbol="diamond", legend=first),
        ]
    at, p_WB, speed = flight.broken(time, flight.p_WB[thinned], _speed(run)[thinned])
    flown = _line("flown", p_WB, at, colour=style.FLOWN, width=6, legend=first)
    flown.line.update(
        color=speed,
        cmin=0.0,
        cmax=fastest or 1.0,
        colorscale="Viridis",
        showscale=first,
        colorbar={"title": {"text": "speed [m/s]"}, "len": 0.7, "thickness": 12},
    )
    traces += drawn_gate_lines(flight, legend=first)
    start = _marks("start", flight.p_WB[:1], colour=style.INK, symbol="square", legend=first)
    return [*_obstacles(flight, legend=first), *traces, flown, start]


def _obstacles(flight: Flight, *, legend: bool) -> list[Any]:
    """Return what it flew among, where that was when it came nearest."""
    shapes = obstacles.drawn_shapes(flight)
    if not shapes:
        return []
    corners, triangles = obstacles.mesh(shapes)
    x, y, z = corners.T
    i, j, k = triangles.T
    trace = plotly("graph_objects").Mesh3d(
        x=x,
        y=y,
        z=z,
        i=i,
        j=j,
        k=k,
        name="obstacle",
        color=obstacles.COLOUR,
        opacity=0.35,
        flatshading=True,
        hoverinfo="name",
        legendgroup="obstacle",
        showlegend=legend,
    )
    return [trace]


def drawn_gate_lines(flight: Flight, *, legend: bool) -> list[Any]:
    """Return the openings of the course's gates as one line, apart by rows of NaN."""
    course = drawn_course(flight)
    if course is None:
        return []
    gap = np.full((1, 3), np.nan)
    openings = [part for _, gate in space.drawn_gates(course) for part in (gate.corners(), gap)]
    line = {"color": style.BOUND, "width": 4}
    return [_scatter("gates", np.vstack(openings), legend=legend, mode="lines", line=line)]


def _line(name: str, p_WB: Array, time: Array, *, colour: str, width: int, legend: bool) -> Any:
    return _scatter(
        name,
        p_WB,
        legend=legend,
        mode="lines",
        line={"color": colour, "width": width},
        customdata=time,
        hovertemplate=_HOVER,
    )


def _marks(name: str, p_WB: Array, *, colour: str, symbol: str, legend: bool) -> Any:
    marker = {"color": colour, "size": 5, "symbol": symbol}
    in_legend = legend and len(p_WB) > 0
    return _scatter(name, p_WB, legend=in_legend, mode="markers", marker=marker)


def _scatter(name: str, p_WB: NDArray[Any], *, legend: bool, **options: Any) -> Any:
    x, y, z = p_WB.T
    return plotly("graph_objects").Scatter3d(
        x=x, y=y, z=z, name=name, legendgroup=name, showlegend=legend, **options
    )


def _speed(run: ReportedRun) -> Array:
    return np.asarray(np.linalg.norm(run.flight.v_WB_B, axis=1))
