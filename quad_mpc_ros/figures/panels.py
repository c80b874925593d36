"""What is drawn over time: one panel a quantity, the flight against its reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.evaluation.flight import Flight
from quad_mpc_ros.figures import style
from quad_mpc_ros.lie import Array, so3

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """One quantity over time [s]; shapes: ``time`` and ``flown`` (m,), the reference (n,) each.

    ``held`` tells that a value holds until the next one, as inputs do. ``reference`` is None
    without one and ``bounds`` are None without any.
    """

    label: str
    time: Array
    flown: Array
    reference_time: Array
    reference: Array | None
    held: bool = False
    bounds: tuple[float, float] | None = None


def position_panels(flight: Flight) -> list[Panel]:
    """Return x, y and z in the world."""
    reference = flight.reference
    return _panels(
        flight, "xyz", "m", flight.p_WB, reference.p_WB if reference is not None else None
    )


def velocity_panels(flight: Flight) -> list[Panel]:
    """Return u, v and w, the velocity in body axes, forward, left and up."""
    reference = flight.reference
    return _panels(
        flight, "uvw", "m/s", flight.v_WB_B, reference.v_WB_B if reference is not None else None
    )


def attitude_panels(flight: Flight) -> list[Panel]:
    """Return the attitude as a quaternion: w, x, y and z.

    A quaternion and its negative are the same attitude, and where the recorded sign changes
    nothing has happened to the vehicle. Both curves therefore start with their own sign and go on
    without a jump. After a turn by more than half a revolution the flight thus converges to the
    negative of the reference, which is the reference, as in Figure 5 of the paper.
    """
    reference = flight.reference
    return _panels(
        flight,
        [f"$q_{axis}$" for axis in "wxyz"],
        "",
        _continuous_wxyz(flight.q_WB_xyzw),
        _continuous_wxyz(so3.quaternion_xyzw_from_rotation(reference.R_WB))
        if reference is not None
        else None,
    )


def input_panels(flight: Flight) -> list[Panel]:
    """Return the commands, throttle and body rates, with the bounds of the controller."""
    commands, reference, mpc = flight.commands, flight.reference, flight.mpc
    labels = ["throttle", *(f"$\\omega_{axis}$ [rad/s]" for axis in "xyz")]
    bounds = [(mpc.throttle_min, mpc.throttle_max), *((-w, w) for w in mpc.omega_max)]
    flown = np.column_stack((commands.throttle, commands.w_WB_B))
    wanted = (
        np.column_stack((reference.throttle, reference.w_WB_B)) if reference is not None else None
    )
    return [
        Panel(
            label=label,
            time=flight.time_of(commands.stamp_ns),
            flown=flown[:, column],
            reference_time=flight.time,
            reference=None if wanted is None else wanted[:, column],
            held=True,
            bounds=bound,
        )
        for column, (label, bound) in enumerate(zip(labels, bounds, strict=True))
    ]


def draw(axes: Axes, panel: Panel) -> None:
    """Draw one panel; the legend is left to the caller."""
    style.tidy(axes)
    if panel.bounds is not None:
        for bound, label in zip(panel.bounds, ("bound", None), strict=True):
            axes.axhline(bound, label=label, **style.BOUND_LINE)
    if panel.reference is not None:
        axes.step(
            panel.reference_time,
            panel.reference,
            where="post",
            label="reference",
            **style.REFERENCE_LINE,
        )
    axes.plot(
        panel.time,
        panel.flown,
        drawstyle="steps-post" if panel.held else "default",
        label="commanded" if panel.held else "flown",
        **style.FLOWN_LINE,
    )
    axes.set_ylabel(panel.label, fontsize=9, color=style.INK)


def _panels(
    flight: Flight, names: str | list[str], unit: str, flown: Array, reference: Array | None
) -> list[Panel]:
    return [
        Panel(
            label=f"{name} [{unit}]" if unit else name,
            time=flight.time,
            flown=flown[:, column],
            reference_time=flight.time,
            reference=None if reference is None else reference[:, column],
        )
        for column, name in enumerate(names)
    ]


def _continuous_wxyz(q_xyzw: Array) -> Array:
    """Return quaternions (n, 4) as w, x, y, z, each with the sign next to the one before."""
    turned = np.sum(q_xyzw[1:] * q_xyzw[:-1], axis=1) < 0.0
    signs = np.cumprod(np.where(np.append(False, turned), -1.0, 1.0))
    return np.asarray(signs[:, None] * np.roll(q_xyzw, 1, axis=1))
