# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The report of an identification: a table, and a ROS parameter file for the controller."""

from __future__ import annotations

import dataclasses
import math
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from quad_mpc_ros.analysis.identification import vehicle_file
from quad_mpc_ros.analysis.identification.result import Identification, ParameterEstimate
from quad_mpc_ros.configuration import UserError, per_axis
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.vehicle import LATENCY_UNCERTAINTY

_WIDTH = 80
# Largest residuals beyond noise, as shares of the variation of body rates and velocity.
_MAX_MISFIT = {"body rates": 0.45, "velocity": 0.2}

_NO_TURNING = "the commanded body rates hardly changed"
_NO_SPEED = "the velocity along this axis hardly changed"
# Flights that excite missing parameters: near one place, and at several m/s.
_SWEEP_OPTIONS = ("--reference excitation", "--duration 21")
_WIDE_SWEEP_OPTIONS = (
    *_SWEEP_OPTIONS,
    "--set 'reference.excitation_reach=[6.0,6.0,2.0]'",
    "--set reference.excitation_speed=8.0",
    "--set reference.excitation_tilt=0.8",
)
_SWEEP_SPACE, _WIDE_SWEEP_SPACE = "4 m by 4 m by 2 m", "12 m by 12 m by 4 m"
_NEED_SPEED = ("drag", "translational_lift")
_UNSURE_TEXT = (
    "too uncertain to be used: the effect cannot be distinguished from other effects (fly more "
    "dynamically, or record more odometries a second), or the vehicle differs from the model "
    "(one delay, no bound on torques)"
)
_OF_AXES = "rate_time_constant", "torque_time_constant", "rate_gain", "drag", "rotor_drag"
_RATE_AXES, _BODY_AXES = ("roll", "pitch", "yaw"), ("x", "y", "z")


@dataclass(frozen=True)
class _Row:
    """A parameter: name, unit, configured value, estimate, reasons if the estimate is unusable."""

    label: str
    unit: str
    given: float
    estimate: ParameterEstimate
    unseen: str
    unsure: str = _UNSURE_TEXT


def _rows(found: Identification, given: MpcConfig) -> list[_Row]:
    def one(name: str, unit: str, unseen: str) -> _Row:
        return _Row(name, unit, getattr(given, name), getattr(found, name), unseen)

    def each(name: str, axes: Sequence[str], unit: str, unseen: str) -> list[_Row]:
        pairs = zip(axes, per_axis(getattr(given, name)), getattr(found, name), strict=True)
        return [_Row(f"{name} {axis}", unit, before, it, unseen) for axis, before, it in pairs]

    scale, no_thrust = found.thrust_scale, "no thrust: fly longer, off the ground"
    # Drag of the rotors that is not observable is included in the drag.
    rotor_drag = each("rotor_drag", _BODY_AXES, "1/s", _NO_SPEED)
    return [
        *each("rate_time_constant", _RATE_AXES, "ms", _NO_TURNING),
        *each("torque_time_constant", _RATE_AXES, "ms", _NO_TURNING),
        *each("rate_gain", _RATE_AXES, "", _NO_TURNING),
        one("thrust_time_constant", "ms", "the commanded throttle hardly changed"),
        one("input_delay", "ms", "the commands hardly changed"),
        _Row("thrust per mass", "", 1.0, scale, no_thrust),
        *each("drag", _BODY_AXES, "1/s", _NO_SPEED),
        one("translational_lift", "1/m", "level flight was slow"),
        *(row for row in rotor_drag if row.estimate.observable),
    ]


def _voltage_rows(found: Identification) -> list[_Row]:
    """Return the row of the voltage; empty without a recorded battery."""
    over = found.over_voltage
    if over is None:
        return []
    return [
        _Row(
            f"thrust by (V/{over.reference:.2f} V)^n",
            "",
            over.compensated,
            over.exponent,
            "the voltage hardly changed",
            unsure="too uncertain to be used: the voltage changed too little for this noise",
        )
    ]


def identification_table(
    found: Identification, given: MpcConfig, *, command_age: float, file: Path | None = None
) -> str:
    """Return configured and estimated values as lines of text, at most 80 columns wide.

    ``command_age`` [s] is from :class:`Measurements`, NaN omits it; ``file`` is the vehicle file
    to be written, for the next flight.
    """
    reported = [*_rows(found, given), *_voltage_rows(found)]
    values = [("", "given", "found", "+- 95 %"), *map(_cells, reported)]
    rows = [
        *text_table(values, align="lrrr", widths=(27, 7, 15, 10), gap=" "),
        "",
        f"flown under commands {found.flown:.1f} s; residuals: body rates "
        f"{found.rate_residual:.3g} rad/s, velocity {found.velocity_residual:.3g} m/s RMS",
    ]
    for note in _notes(found, given, command_age):
        rows += textwrap.wrap(note, _WIDTH, subsequent_indent="  ")
    return "\n".join((*rows, *proposal(found, given, file=file)))


def proposal(found: Identification, given: MpcConfig, *, file: Path | None) -> list[str]:
    """Return lines with a flight that excites the missing parameters; empty if none is missing.

    The flight uses the vehicle ``file`` of this fit, if the fit is usable.
    """
    refused = refusal(found) is not None
    missing = [row.label for row in _rows(found, given) if not row.estimate.observable]
    if not missing and not refused:
        return []
    wide = not refused and any(label.startswith(_NEED_SPEED) for label in missing)
    flight = [] if refused or file is None else [f"--config {shlex.quote(str(file))}"]
    flight += _WIDE_SWEEP_OPTIONS if wide else _SWEEP_OPTIONS
    room = _WIDE_SWEEP_SPACE if wide else _SWEEP_SPACE
    return [
        "",
        f"An excitation flight identifies more, in {room} (docs/howto/references.md):",
        " \\\n    ".join(("  quad_mpc fly", *flight)),
    ]


def warnings(found: Identification, given: MpcConfig) -> Iterator[str]:
    """Yield warnings about parameters that are not observable and about bad fits."""
    unobservable: dict[str, list[str]] = {}
    for row in (*_rows(found, given), *_voltage_rows(found)):
        estimate, value = row.estimate, _number(row.estimate.value, row.unit)
        if estimate.at_bound:
            yield (
                f"{row.label} was estimated as {f'{value} {row.unit}'.strip()}, the end of the "
                "search range: the model does not fit; the configured value is kept"
            )
        elif not estimate.seen:
            unobservable.setdefault(
                f"cannot be identified from this flight: {row.unseen}", []
            ).append(row.label)
        elif not estimate.observable:
            unobservable.setdefault(row.unsure, []).append(row.label)
    yield from (f"{', '.join(labels)} {reason}" for reason, labels in unobservable.items())
    if (reason := refusal(found)) is not None:
        yield reason


def refusal(found: Identification) -> str | None:
    """Return the reason why a fit must not be used; None for a usable fit."""
    for (name, most), misfit in zip(_MAX_MISFIT.items(), found.misfit, strict=True):
        if misfit > most:
            return (
                f"{misfit:.0%} of the variation of the {name} is unexplained beyond noise, "
                f"expected {most:.0%} or less: odometry and commands of one vehicle, rates in "
                "the frame of odometry.twist_frame, an unsaturated rate loop"
            )
    return None


def parameter_file(
    found: Identification,
    given: MpcConfig,
    *,
    bag: Path,
    keep: vehicle_file.Kept,
    bridge: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """Return the text of the complete vehicle file.

    Args:
        found: The identification.
        given: The configured vehicle, whose values are kept where they are not observable.
        bag: The bag, for the remark.
        keep: With mass the thrust curve is scaled, with curve the mass changes.
        bridge: The recorded parameters of the bridge, for the thrust map.

    Raises:
        UserError: The fit explains too little of the flight.
        ConfigurationError: The controller would reject the values.
    """
    if (reason := refusal(found)) is not None:
        raise UserError(f"nothing is written: {reason}")
    entries: vehicle_file.Entries = {}
    for name in _OF_AXES:
        usable = [_usable(estimate) for estimate in getattr(found, name)]
        entries[name] = vehicle_file.axes_entry(usable, getattr(given, name))
    for name in ("thrust_time_constant", "input_delay", "translational_lift"):
        estimate = _usable(getattr(found, name))
        entries[name] = (
            (getattr(given, name), vehicle_file.UNOBSERVABLE)
            if estimate is None
            else vehicle_file.found_entry(estimate)
        )
    latency = found.latency_half_width
    if latency is not None:
        width = min(max(latency, LATENCY_UNCERTAINTY[0]), LATENCY_UNCERTAINTY[1])
        entries["latency_uncertainty"] = vehicle_file.rounded(width), "of roll and pitch"
    if found.thrust_scale.observable:
        entries |= vehicle_file.thrust_entries(found.thrust_scale, given, keep=keep)
    else:
        kept = ("mass", "thrust_curve", "motor_count")
        entries |= {name: (getattr(given, name), vehicle_file.UNOBSERVABLE) for name in kept}
    remark = f"Identified from {bag}, {found.flown:.1f} s of flight under commands; +- is 95 %."
    scales_curve = found.thrust_scale.observable and keep == "mass"
    thrust_map = vehicle_file.map_entries(
        bridge, found.thrust_scale.value if scales_curve else 1.0
    )
    over = found.over_voltage
    if over is not None and over.falls:
        volt = vehicle_file.rounded(over.reference)
        thrust_map["thrust_map.battery_voltage"] = (volt, "at which the thrust curve is valid")
        thrust_map["thrust_map.battery_exponent"] = vehicle_file.found_entry(over.exponent)
    return vehicle_file.content(entries, given, remarks=[remark], thrust_map=thrust_map)


def _usable(estimate: ParameterEstimate) -> ParameterEstimate | None:
    """Return an estimate for the file, at least zero; None if not observable."""
    if not estimate.observable:
        return None
    return dataclasses.replace(estimate, value=max(estimate.value, 0.0))


def _cells(row: _Row) -> tuple[str, ...]:
    estimate = row.estimate
    label = f"{row.label} [{row.unit}]" if row.unit else row.label
    before = _number(row.given, row.unit)
    if not estimate.seen or estimate.at_bound:
        return label, before, "not observable", "-"
    factor, digits = _scale(row.unit)
    least = 10.0**-digits
    width = max(math.ceil(factor * estimate.half_width / least) * least, least)
    mark = "" if estimate.observable else "? "
    return label, before, f"{mark}{_number(estimate.value, row.unit)}", f"{width:.{digits}f}"


def _number(value: float, unit: str) -> str:
    factor, digits = _scale(unit)
    return f"{factor * value:.{digits}f}"


def _scale(unit: str) -> tuple[float, int]:
    """Return the factor and the number of decimals with which a value is printed."""
    return (1e3, 1) if unit == "ms" else (1.0, 4 if unit == "1/m" else 3)


def _notes(found: Identification, given: MpcConfig, command_age: float) -> Iterator[str]:
    if found.fitted != found.flown:
        yield f"fitted to {found.fitted:.1f} s of that, spread evenly over the flight"
    if found.thrust_scale.observable:
        scale = found.thrust_scale.value
        yield (
            f"thrust per mass {scale:.3f}: the configured curve with a mass of "
            f"{given.mass / scale:.3f} kg, or {scale:.3f} of this curve with the configured "
            f"mass, {given.mass:.3f} kg"
        )
    yield from _voltage_notes(found)
    east, north = (f"{push + 0.0:.2f}" for push in found.wind_acceleration_W)
    yield f"wind and other disturbances: {east} m/s^2 east and {north} m/s^2 north"
    if not math.isnan(command_age) and found.input_delay.observable:
        yield (
            "input_delay is the time from the stamp of the odometry to the effect of the command. "
            f"The command is published after {1e3 * command_age:.1f} ms (median)"
        )
    yield from (f"warning: {text}" for text in warnings(found, given))


def _voltage_notes(found: Identification) -> Iterator[str]:
    over = found.over_voltage
    if over is None or not over.exponent.observable:
        return
    text = f"thrust over voltage: power {over.exponent.value:.2f} at {over.reference:.2f} V"
    if over.falls:
        yield f"{text}, battery_exponent and battery_voltage of the bridge's thrust_map"
    else:
        yield (f"{text}, not significant: leave thrust_map.battery_voltage of the bridge at 0")
