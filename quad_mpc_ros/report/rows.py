"""The rows of the report: the paper's four figures, the errors, the solver, who commanded."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.evaluation.metrics import attitude_errors, position_errors
from quad_mpc_ros.figures import panels, style
from quad_mpc_ros.report.row import Curve, Row, row_of
from quad_mpc_ros.report.run import ReportedRun
from quad_mpc_ros.safety.ladder import Source

_MICROSECONDS = 1e6
_STEP_COLOUR = "#009E73"  # of the same palette as the others
_SOURCES = [source.name.lower() for source in Source]


def position_rows(run: ReportedRun) -> list[Row]:
    """Return Figure 4 of the paper: the position in the world."""
    return [row_of(panel) for panel in panels.position_panels(run.flight)]


def attitude_rows(run: ReportedRun) -> list[Row]:
    """Return Figure 5 of the paper: the attitude as a quaternion."""
    return [row_of(panel) for panel in panels.attitude_panels(run.flight)]


def velocity_rows(run: ReportedRun) -> list[Row]:
    """Return Figure 6 of the paper: the velocity in body axes."""
    return [row_of(panel) for panel in panels.velocity_panels(run.flight)]


def input_rows(run: ReportedRun) -> list[Row]:
    """Return Figure 7 of the paper: throttle and body rates, with their bounds."""
    return [row_of(panel) for panel in panels.input_panels(run.flight)]


def error_rows(run: ReportedRun) -> list[Row]:
    """Return the distance and the angle to the reference."""
    flight = run.flight
    time = flight.time if flight.reference is not None else np.zeros(0)
    errors = {
        "position [m]": position_errors(flight),
        "attitude [rad]": attitude_errors(flight),
    }
    return [
        Row(
            label=label,
            curves=[Curve(name="error", time=time, values=values, colour=style.FLOWN)],
        )
        for label, values in errors.items()
    ]


def solver_rows(run: ReportedRun) -> list[Row]:
    """Return times against the control period, and iterations, of the ticks that solved."""
    stats = run.flight.stats
    ran = stats["solver_status"] != "not run"
    time, status = run.tick_time[ran], stats["solver_status"][ran]
    curves = {
        name: Curve(name=name, time=time, values=stats[field][ran], colour=colour, hover=status)
        for name, field, colour in (
            ("control step", "step_time_us", _STEP_COLOUR),
            ("solve", "solve_time_us", style.FLOWN),
            ("iterations", "iterations", style.FLOWN),
        )
    }
    return [
        Row(
            label="time [µs]",
            curves=[curves["control step"], curves["solve"]],
            bounds=[_MICROSECONDS / run.flight.mpc.control_rate],
            logarithmic=True,
        ),
        Row(label="iterations", curves=[curves["iterations"]]),
    ]


def source_rows(run: ReportedRun) -> list[Row]:
    """Return the rung of the safety ladder that commanded, and the reason for it."""
    stats = run.flight.stats
    curve = Curve(
        name="commanding",
        time=run.tick_time,
        values=np.array([_SOURCES.index(str(name)) for name in stats["source"]], dtype=np.int64),
        colour=style.INK,
        width=2.0,
        held=True,
        hover=stats["reason"],
    )
    return [Row(label="", curves=[curve], names=_SOURCES)]
