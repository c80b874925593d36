"""An identification told: a table for people, a ROS parameter file for the controller."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from pathlib import Path

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.identification import vehicle_file
from quad_mpc_ros.identification.result import Estimate, Identification
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.text_tables import text_table

_WIDTH = 80
_LEAST_EXPLAINED = 0.8

_LIVELY = "fly the square, or the lemniscate with reference.angular_frequency 2"
_MANOEUVRE = {
    "rate_time_constant": f"the body rates were hardly commanded to change: {_LIVELY}",
    "thrust_time_constant": f"the throttle was hardly commanded to change: {_LIVELY}",
    "input_delay": f"the commands hardly changed: {_LIVELY}",
    "thrust_scale": "the thrust does not show: fly longer, off the ground",
    "drag": "the velocity hardly changed: fly the lemniscate, several m/s fast",
}


def identification_table(found: Identification, given: MpcConfig, *, command_age: float) -> str:
    """Return what was found beside what was given as lines of text, at most 80 columns wide.

    ``command_age`` [s] is that of :class:`Measurements`, NaN to be silent of it.
    """
    values = [
        ("", "given", "found", "+- 95 %"),
        _row(
            "rate_time_constant",
            "ms",
            per_axis(given.rate_time_constant)[0],
            found.rate_time_constant,
        ),
        _row("thrust_time_constant", "ms", given.thrust_time_constant, found.thrust_time_constant),
        _row("input_delay", "ms", given.input_delay, found.input_delay),
        _row("thrust per mass", "", 1.0, found.thrust_scale),
        _row("drag", "1/s", per_axis(given.drag)[0], found.drag),
    ]
    rows = [
        *text_table(values, align="lrrr", widths=(26, 8, 12, 12), gap=""),
        "",
        f"flown under commands {found.flown:.1f} s; left over: body rates "
        f"{found.rate_residual:.3g} rad/s, velocity {found.velocity_residual:.3g} m/s RMS",
    ]
    for note in _notes(found, given, command_age):
        rows += textwrap.wrap(note, _WIDTH, subsequent_indent="  ")
    return "\n".join(rows)


def warnings(found: Identification) -> Iterator[str]:
    """Yield what the flight does not show and how to fly one that does, and bad fits."""
    for name, manoeuvre in _MANOEUVRE.items():
        estimate: Estimate = getattr(found, name)
        if not estimate.seen:
            yield f"{name} cannot be told from this flight: {manoeuvre}"
        elif not estimate.observable:
            yield (
                f"{name} is too uncertain to be used: its effect cannot be told from that of "
                "the others, which a livelier flight or more odometries a second help, or the "
                "vehicle is not as the model says (lags of first order, one delay, drag alike in "
                "all directions)"
            )
    rates_seen = found.rate_time_constant.observable or found.input_delay.observable
    if rates_seen and found.rates.explained < _LEAST_EXPLAINED:
        yield (
            f"the commands explain only {max(found.rates.explained, 0.0):.0%} of the measured "
            "body rates: expected the odometry and the commands of one vehicle, the rates in the "
            "frame of odometry.twist_frame, and a rate loop that is nearly of first order"
        )


def parameter_file(
    found: Identification, given: MpcConfig, *, bag: Path, keep: vehicle_file.Kept
) -> str:
    """Return a ROS parameter file for the controller with what the flight shows.

    With ``keep`` mass the thrust curve is scaled, with curve the mass. Raises
    ``ConfigurationError`` when the controller would refuse the values.
    """
    entries: vehicle_file.Entries = {}
    left_out = []
    for name in ("rate_time_constant", "thrust_time_constant", "input_delay", "drag"):
        estimate: Estimate = getattr(found, name)
        if estimate.observable:
            entries[name] = vehicle_file.found_entry(estimate)
        else:
            left_out.append(name)
    if found.thrust_scale.observable:
        entries |= vehicle_file.thrust_entries(found.thrust_scale, given, keep=keep)
    else:
        left_out.append("thrust_curve")
    remarks = [
        f"Identified from {bag}, {found.flown:.1f} s of flight under commands; +- is 95 %.",
        *(f"{name}: not told by this flight." for name in left_out),
    ]
    return vehicle_file.content(entries, given, remarks=remarks)


def _row(name: str, unit: str, given: float, estimate: Estimate) -> tuple[str, ...]:
    factor, digits = (1e3, 1) if unit == "ms" else (1.0, 3)
    label = f"{name} [{unit}]" if unit else name
    before = f"{factor * given:.{digits}f}"
    if not estimate.seen:
        return label, before, "not seen", "-"
    least = 10.0**-digits
    width = max(math.ceil(factor * estimate.half_width / least) * least, least)
    return label, before, f"{factor * estimate.value:.{digits}f}", f"{width:.{digits}f}"


def _notes(found: Identification, given: MpcConfig, command_age: float) -> Iterator[str]:
    if found.fitted != found.flown:
        yield f"fitted to {found.fitted:.1f} s of that, spread evenly over the flight"
    if found.thrust_scale.observable:
        scale = found.thrust_scale.value
        yield (
            f"thrust per mass {scale:.3f}: the given curve lifting {given.mass / scale:.3f} kg, "
            f"or {scale:.3f} of the given curve lifting the given {given.mass:.3f} kg"
        )
    east, north = (f"{push + 0.0:.2f}" for push in found.wind_acceleration_W)
    yield f"wind and the like push by {east} m/s^2 east and {north} m/s^2 north"
    if not math.isnan(command_age) and found.input_delay.observable:
        yield (
            "input_delay counts from the stamp of the odometry to the effect of the command; "
            f"{1e3 * command_age:.1f} ms of it (median) pass until the command is published"
        )
    yield from (f"warning: {text}" for text in warnings(found))
