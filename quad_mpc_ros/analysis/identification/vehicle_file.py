# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Vehicle file: identified and kept parameters of the vehicle, for all nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

from quad_mpc_ros.analysis.identification.result import ParameterEstimate
from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.configuration.files import value_text
from quad_mpc_ros.configuration.vehicle import VEHICLE
from quad_mpc_ros.control.config import MpcConfig

Kept = Literal["mass", "curve"]
"""The part of the thrust per mass to keep; only the quotient is observable."""

Entries = dict[str, tuple[Any, str]]
"""Values by parameter name, each with a remark."""

KEPT, UNOBSERVABLE = "kept", "kept, not observable"
# Parameters of each kind of thrust map, and those that scale with the thrust.
_MAP_KEYS = {
    "model": (),
    "linear": ("full_thrust",),
    "quadratic": ("motor_curve",),
    "table": ("table_throttle", "table_thrust"),
}
_SCALED_KEYS = ("full_thrust", "motor_curve", "table_thrust")
_MAP_PREFIX = "thrust_map."
_DIGITS, _DECIMALS = 4, 7  # of written values


def found_entry(estimate: ParameterEstimate) -> tuple[float, str]:
    """Return an identified value and its uncertainty."""
    return rounded(estimate.value), f"+- {estimate.half_width:.2g}"


def axes_entry(estimates: Sequence[ParameterEstimate | None], given: PerAxis) -> tuple[Any, str]:
    """Return a value and its uncertainty for each body axis; None keeps the configured value.

    If all are None, the configured value is kept, one number or three.
    """
    if all(estimate is None for estimate in estimates):
        return given, UNOBSERVABLE
    values, notes = [], []
    for estimate, kept in zip(estimates, per_axis(given), strict=True):
        value, note = (kept, UNOBSERVABLE) if estimate is None else found_entry(estimate)
        values.append(value)
        notes.append(note)
    return values, "; ".join(notes)


def thrust_entries(scale: ParameterEstimate, given: MpcConfig, *, keep: Kept) -> Entries:
    """Return mass, thrust curve and motor count for ``scale`` times the thrust per mass.

    With ``keep`` mass the thrust curve is scaled, with curve the mass changes.
    """
    spread = f"thrust per mass x {scale.value:.4f} +- {scale.half_width:.2g}"
    if keep == "mass":
        scaled = [rounded(scale.value * c) for c in given.thrust_curve]
        entries: Entries = {"mass": (given.mass, KEPT), "thrust_curve": (scaled, spread)}
    else:
        mass = rounded(given.mass / scale.value)
        entries = {"mass": (mass, spread), "thrust_curve": (given.thrust_curve, KEPT)}
    return entries | {"motor_count": (given.motor_count, KEPT)}


def map_entries(recorded: Mapping[str, Any], scale: float) -> Entries:
    """Return the thrust map among the recorded parameters of a bridge, with scaled thrust.

    The map converts thrust to the throttle of the stack, so map and thrust curve are scaled
    together. Empty without a recorded map.
    """
    kind = recorded.get(f"{_MAP_PREFIX}kind")
    if kind not in _MAP_KEYS:
        return {}
    entries: Entries = {f"{_MAP_PREFIX}kind": (kind, KEPT)}
    for name in (*_MAP_KEYS[kind], "battery_voltage", "battery_exponent"):
        value = recorded.get(f"{_MAP_PREFIX}{name}")
        if value is None:
            continue
        if name in _SCALED_KEYS and scale != 1.0:
            scaled = (
                rounded(scale * value)
                if isinstance(value, int | float)
                else [rounded(scale * v) for v in value]
            )
            entries[f"{_MAP_PREFIX}{name}"] = (scaled, f"x {scale:.4f}, like the thrust curve")
        else:
            entries[f"{_MAP_PREFIX}{name}"] = (value, KEPT)
    return entries


def content(
    entries: Mapping[str, tuple[Any, str]],
    given: MpcConfig,
    *,
    remarks: Sequence[str],
    thrust_map: Mapping[str, tuple[Any, str]] = MappingProxyType({}),
) -> str:
    """Return the text of the file, below ``remarks``; other parameters keep configured values.

    Raises ``ConfigurationError`` if the controller would reject the values.
    """
    given.updated({name: value for name, (value, _) in entries.items()})
    lines = [*(f"# {remark}" for remark in remarks), "/**:", "  ros__parameters:"]
    for name in VEHICLE:
        value, note = entries.get(name, (getattr(given, name), KEPT))
        lines.append(f"    {name}: {value_text(value)}  # {note}")
    if thrust_map:
        lines.append(f"    {_MAP_PREFIX.rstrip('.')}:")
    for name, (value, note) in thrust_map.items():
        lines.append(f"      {name.removeprefix(_MAP_PREFIX)}: {value_text(value)}  # {note}")
    return "\n".join(lines) + "\n"


def rounded(value: float) -> float:
    """Return a value rounded to significant digits."""
    return round(float(f"{value:.{_DIGITS}g}"), _DECIMALS)
