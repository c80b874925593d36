"""What is drawn over time: panels of curves, the same for pictures and for the report's page."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.recordings.evaluation.metrics import attitude_errors, position_errors
from quad_mpc_ros.recordings.flight import Flight

Weight = Literal["normal", "strong", "broad"]
"""How thick a curve is. A broad one lies below the others: it is seen where they lie on it."""

LEVELS = tuple(source.name.lower() for source in Source)
"""The rungs of the safety ladder, as :func:`source_panels` numbers them."""

AVOIDANCE = ("off", "free", "around", "stopped", "failed")
"""What is flown among obstacles, as :func:`clearance_panels` numbers it."""

_STEP_COLOUR = "#009E73"  # of the same palette as the others


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Values over time [s], both (n,); ``held`` if each holds until the next.

    ``hover`` (n,) is shown beside a value where the pointer is, on a page.
    """

    name: str
    time: Array
    values: NDArray[Any]
    colour: str = style.FLOWN
    weight: Weight = "normal"
    held: bool = False
    hover: NDArray[Any] | None = None

    def thinned(self, most: int) -> Curve:
        """Return the least and the greatest value of ``most`` / 2 stretches, so peaks stay.

        Breaks, the first of values that are not numbers, stay as well.

        A curve of no more than ``most`` values is returned as it is.
        """
        count = len(self.time)
        if count <= most:
            return self
        length = -(-count // (most // 2))
        begins = np.arange(0, count, length)
        values = np.asarray(self.values, dtype=np.float64)
        padded = np.full(len(begins) * length, np.nan)
        padded[:count] = values
        stretches = padded.reshape(-1, length)
        least = np.argmin(np.where(np.isnan(stretches), np.inf, stretches), axis=1)
        greatest = np.argmax(np.where(np.isnan(stretches), -np.inf, stretches), axis=1)
        missing = np.isnan(values)
        breaks = np.flatnonzero(missing & ~np.append(False, missing[:-1]))
        ends = [0, count - 1]
        kept = np.unique(np.concatenate((ends, breaks, begins + least, begins + greatest)))
        return dataclasses.replace(
            self,
            time=self.time[kept],
            values=self.values[kept],
            hover=None if self.hover is None else self.hover[kept],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """Curves on one axis: a quantity, like ω with subscript x and unit rad/s, and its bounds.

    Curves are drawn in their order. ``levels`` are the names of the values 0, 1, … when these
    stand for something.
    """

    name: str
    subscript: str = ""
    unit: str = ""
    curves: Sequence[Curve]
    bounds: Sequence[float] = ()
    bound_name: str = "bound"
    logarithmic: bool = False
    levels: Sequence[str] = ()

    def curve(self, name: str) -> Curve:
        """Return a curve by its name; raises ``KeyError`` when there is none."""
        return {curve.name: curve for curve in self.curves}[name]


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

    A quaternion and its negative are the same attitude, and where the recorded sign changes
    nothing has happened to the vehicle. Both curves therefore start with their own sign and go on
    without a jump. After a turn by more than half a revolution the flight thus converges to the
    negative of the reference, which is the reference, as in the paper.
    """
    reference = None
    if flight.reference is not None:
        reference = _continuous_wxyz(so3.quaternion_xyzw_from_rotation(flight.reference.R_WB))
    flown = _continuous_wxyz(flight.q_WB_xyzw)
    return _tracked(flight, [("q", axis) for axis in "wxyz"], "", flown, reference)


def input_panels(flight: Flight) -> list[Panel]:
    """Return Figure 7: the commands, throttle and body rates, with the controller's bounds."""
    commands, reference, mpc = flight.commands, flight.reference, flight.mpc
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
    """Return the distance and the angle to the reference."""
    errors = (
        ("position", "m", position_errors(flight)),
        ("attitude", "rad", attitude_errors(flight)),
    )
    nothing = Curve(name="error", time=np.zeros(0), values=np.zeros(0))
    return [
        Panel(
            name=name,
            unit=unit,
            curves=[
                _curve_of_odometry(flight, values, name="error")
                if flight.reference is not None
                else nothing
            ],
        )
        for name, unit, values in errors
    ]


def solver_panels(flight: Flight) -> list[Panel]:
    """Return times against the control period, and iterations, of the ticks that solved."""
    stats = flight.stats
    ran = stats["solver_status"] != "not run"
    time, status = flight.tick_time[ran], stats["solver_status"][ran]

    def curve(name: str, field: str, colour: str = style.FLOWN) -> Curve:
        return Curve(name=name, time=time, values=stats[field][ran], colour=colour, hover=status)

    return [
        Panel(
            name="time",
            unit="µs",
            curves=[
                curve("control step", "step_time_us", _STEP_COLOUR),
                curve("solve", "solve_time_us"),
            ],
            bounds=[1e6 / flight.mpc.control_rate],
            logarithmic=True,
        ),
        Panel(name="iterations", curves=[curve("iterations", "iterations")]),
    ]


def clearance_panels(flight: Flight) -> list[Panel]:
    """Return from the vehicle's surface to the nearest obstacle's, and what the controller knew.

    Without obstacles there are none.
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
                weight="broad",
            )
        )
    if true is not None:
        curves.append(_curve_of_odometry(flight, true, name="flown", weight="strong"))
    if not curves:
        return []
    panels = [
        Panel(name="clearance", unit="m", curves=curves, bounds=[0.0], bound_name="collision")
    ]
    states = flight.stats.get("avoidance")
    if states is not None:
        numbers = [AVOIDANCE.index(str(each)) for each in states]
        panels.append(
            Panel(
                name="",
                levels=AVOIDANCE,
                curves=[
                    Curve(
                        name="avoidance",
                        time=flight.tick_time,
                        values=np.array(numbers, dtype=np.int64),
                        colour=style.INK,
                        held=True,
                        hover=flight.stats["avoidance_reason"],
                    )
                ],
            )
        )
    return panels


def source_panels(flight: Flight) -> list[Panel]:
    """Return the rung of the safety ladder that commanded, and the reason for it."""
    stats = flight.stats
    curve = Curve(
        name="commanding",
        time=flight.tick_time,
        values=np.array([LEVELS.index(str(name)) for name in stats["source"]], dtype=np.int64),
        colour=style.INK,
        weight="strong",
        held=True,
        hover=stats["reason"],
    )
    return [Panel(name="", curves=[curve], levels=LEVELS)]


def _tracked(
    flight: Flight,
    quantities: Sequence[tuple[str, str]],
    unit: str,
    flown: Array,
    reference: Array | None,
) -> list[Panel]:
    """Return a panel for each column of what was flown (n, k), with its reference."""
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
            weight="broad",
            held=True,
        )
    ]


def _curve_of_odometry(flight: Flight, values: Array, **look: Any) -> Curve:
    """Return values at each odometry (n,) as a curve that is broken where odometry is missing."""
    time, broken = flight.broken(flight.time, values)
    return Curve(time=time, values=broken, **look)


def _continuous_wxyz(q_xyzw: Array) -> Array:
    """Return quaternions (n, 4) as w, x, y, z, each with the sign next to the one before."""
    turned = np.sum(q_xyzw[1:] * q_xyzw[:-1], axis=1) < 0.0
    signs = np.cumprod(np.where(np.append(False, turned), -1.0, 1.0))
    return np.asarray(signs[:, None] * np.roll(q_xyzw, 1, axis=1))
