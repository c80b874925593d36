# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Panels of curves over time: state, errors, inputs, solver and command source of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.recordings.evaluation.metrics import attitude_errors, position_errors
from quad_mpc_ros.recordings.flight import Flight

_SOURCES = tuple(source.name.lower() for source in Source)
_AVOIDANCE = ("off", "free", "around", "stopped", "failed")

_STEP_COLOUR = "#009E73"  # of the same palette as the others


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Values over time [s], both (n,).

    With ``held`` each value is held until the next. A ``broad`` curve is drawn below other curves,
    so that coinciding curves stay visible.
    """

    name: str
    time: Array
    values: NDArray[Any]
    colour: str = style.FLOWN
    broad: bool = False
    held: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """Curves on one axis: a quantity, like ω with subscript x and unit rad/s, and its bounds.

    Curves are drawn in their order. ``levels`` are the names of the values 0, 1, … of an
    enumeration.
    """

    name: str
    subscript: str = ""
    unit: str = ""
    curves: Sequence[Curve]
    bounds: Sequence[float] = ()
    bound_name: str = "bound"
    logarithmic: bool = False
    levels: Sequence[str] = ()


def position_panels(flight: Flight) -> list[Panel]:
    """Return Figure 4 of the paper: x, y and z in the world."""
    reference = None if flight.reference is None else flight.reference.p_WB
    return _tracked(flight, [(name, "") for name in "xyz"], "m", flight.p_WB, reference)


def velocity_panels(flight: Flight) -> list[Panel]:
    """Return Figure 6: u, v and w, the velocity in body axes, forward, left and up."""
    reference = None if flight.reference is None else flight.reference.v_WB_B
    return _tracked(flight, [(name, "") for name in "uvw"], "m/s", flight.v_WB_B, reference)


def attitude_panels(flight: Flight) -> list[Panel]:
    """Return Figure 5: the attitude as a quaternion, w, x, y and z.

    A quaternion and its negative are the same attitude, so the recorded sign may change at any
    time. Both curves start with the recorded sign and continue without a jump. After more than
    half a revolution the flight converges to the negative reference, as in the paper.
    """
    reference = None
    if flight.reference is not None:
        reference = _continuous_wxyz(so3.quaternion_xyzw_from_rotation(flight.reference.R_WB))
    flown = _continuous_wxyz(flight.q_WB_xyzw)
    return _tracked(flight, [("q", axis) for axis in "wxyz"], "", flown, reference)


def input_panels(flight: Flight) -> list[Panel]:
    """Return Figure 7: commanded throttle and body rates, with the bounds of the controller.

    Empty without commands.
    """
    commands, reference, mpc = flight.commands, flight.reference, flight.mpc
    if not len(commands.stamp_ns):
        return []
    wanted = None
    if reference is not None:
        wanted = np.column_stack((reference.throttle, reference.w_WB_B))
    time = flight.time_of(commands.stamp_ns)
    commanded = np.column_stack((commands.throttle, commands.w_WB_B))
    quantities = [("throttle", "", ""), *(("ω", axis, "rad/s") for axis in "xyz")]
    bounds = [(mpc.throttle_min, mpc.throttle_max), *((-w, w) for w in mpc.omega_max)]
    return [
        Panel(
            name=name,
            subscript=subscript,
            unit=unit,
            curves=[
                *_reference_curve(flight, wanted, column),
                Curve(name="commanded", time=time, values=commanded[:, column], held=True),
            ],
            bounds=bound,
        )
        for column, ((name, subscript, unit), bound) in enumerate(
            zip(quantities, bounds, strict=True)
        )
    ]


def error_panels(flight: Flight) -> list[Panel]:
    """Return the distance and the angle to the reference; empty without a reference."""
    if flight.reference is None:
        return []
    errors = (
        ("position error", "m", position_errors(flight)),
        ("attitude error", "rad", attitude_errors(flight)),
    )
    return [
        Panel(name=name, unit=unit, curves=[_curve_of_odometry(flight, values, name="error")])
        for name, unit, values in errors
    ]


def solver_panels(flight: Flight) -> list[Panel]:
    """Return times and iterations of the ticks at which the solver ran; else empty."""
    stats = flight.stats
    ran = stats["solver_status"] != "not run"
    if not ran.any():
        return []

    def curve(name: str, key: str, colour: str = style.FLOWN) -> Curve:
        return Curve(name=name, time=flight.tick_time[ran], values=stats[key][ran], colour=colour)

    return [
        Panel(
            name="time",
            unit="µs",
            curves=[
                curve("control step", "step_time_us", _STEP_COLOUR),
                curve("solve", "solve_time_us"),
            ],
            bounds=[1e6 / flight.mpc.control_rate],
            bound_name="control period",
            logarithmic=True,
        ),
        Panel(name="iterations", curves=[curve("iterations", "iterations")]),
    ]


def clearance_panels(flight: Flight) -> list[Panel]:
    """Return the true and the known distance to obstacles, and the state of the avoidance.

    Distances are from the surface of the vehicle. Empty without obstacles.
    """
    true, known = flight.clearance, flight.stats.get("clearance_m")
    curves = []
    if known is not None and np.isfinite(known).any():
        values = np.where(np.isfinite(known), known, np.nan)
        curves.append(
            Curve(
                name="known",
                time=flight.tick_time,
                values=values,
                colour=style.REFERENCE,
                broad=True,
            )
        )
    if true is not None:
        curves.append(_curve_of_odometry(flight, true, name="flown"))
    if not curves:
        return []
    found = [
        Panel(name="clearance", unit="m", curves=curves, bounds=[0.0], bound_name="collision")
    ]
    if "avoidance" in flight.stats:
        found += _level_panels(flight, "avoidance", _AVOIDANCE)
    return found


def source_panels(flight: Flight) -> list[Panel]:
    """Return the source of the command at each tick; empty without ticks."""
    return _level_panels(flight, "source", _SOURCES) if len(flight.stats["source"]) else []


def _level_panels(flight: Flight, key: str, levels: Sequence[str]) -> list[Panel]:
    """Return an enumeration in the statistics of the ticks, with the names of its values."""
    numbers = np.array([levels.index(str(each)) for each in flight.stats[key]], dtype=np.int64)
    curve = Curve(name=key, time=flight.tick_time, values=numbers, colour=style.INK, held=True)
    return [Panel(name="", curves=[curve], levels=levels)]


def _tracked(
    flight: Flight,
    quantities: Sequence[tuple[str, str]],
    unit: str,
    flown: Array,
    reference: Array | None,
) -> list[Panel]:
    """Return a panel for each column of the flown quantity (n, k), with its reference."""
    return [
        Panel(
            name=name,
            subscript=subscript,
            unit=unit,
            curves=[
                *_reference_curve(flight, reference, column),
                _curve_of_odometry(flight, flown[:, column], name="flown"),
            ],
        )
        for column, (name, subscript) in enumerate(quantities)
    ]


def _reference_curve(flight: Flight, reference: Array | None, column: int) -> list[Curve]:
    if reference is None:
        return []
    return [
        _curve_of_odometry(
            flight,
            reference[:, column],
            name="reference",
            colour=style.REFERENCE,
            broad=True,
            held=True,
        )
    ]


def _curve_of_odometry(flight: Flight, values: Array, **look: Any) -> Curve:
    """Return values at each odometry (n,) as a curve, interrupted where odometry is missing."""
    time, broken = flight.broken(flight.time, values)
    return Curve(time=time, values=broken, **look)


def _continuous_wxyz(q_xyzw: Array) -> Array:
    """Return quaternions (n, 4) as w, x, y, z, with continuous signs."""
    turned = np.sum(q_xyzw[1:] * q_xyzw[:-1], axis=1) < 0.0
    signs = np.cumprod(np.where(np.append(False, turned), -1.0, 1.0))
    return np.asarray(signs[:, None] * np.roll(q_xyzw, 1, axis=1))
