"""The vehicle file, which every node reads its share of: what was found, and what was kept."""

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
"""What is kept of thrust per mass, of which only the quotient is observable."""

Entries = dict[str, tuple[Any, str]]
"""Values by the name of their parameter, each with a remark."""

KEPT, UNOBSERVABLE = "kept", "kept, not observable"
# What a bridge reads of its thrust map, and what of that scales with the thrust.
_MAP_KEYS = {
    "model": (),
    "linear": ("full_thrust",),
    "quadratic": ("motor_curve",),
    "table": ("table_throttle", "table_thrust"),
}
_SCALED_KEYS = ("full_thrust", "motor_curve", "table_thrust")
_MAP_PREFIX = "thrust_map."
_DIGITS, _DECIMALS = 4, 7  # of what is written


def found_entry(estimate: ParameterEstimate) -> tuple[float, str]:
    """Return a found value and how far off it may be."""
    return rounded(estimate.value), f"+- {estimate.half_width:.2g}"


def axes_entry(estimates: Sequence[ParameterEstimate | None], given: PerAxis) -> tuple[Any, str]:
    """Return a value for each body axis, and how far off each may be; None is kept as given.

    What is kept of all of them stays as it was given, one number or three.
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
    """Return what makes the given vehicle one of ``scale`` times its thrust per mass.

    With ``keep`` mass the thrust curve is scaled, with curve the mass.
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
    """Return what of a bridge's recorded parameters is its thrust map, its thrust times a scale.

    A throttle of the stack makes the thrust that the map states, so the map is scaled together
    with the thrust curve. Empty where no map is recorded.
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
            entries[f"{_MAP_PREFIX}{name}"] = (scaled, f"x {scale:.4f}, as the thrust curve")
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
    """Return the text of the file, below ``remarks``; what has no entry is kept as given.

    Raises ``ConfigurationError`` when the controller would refuse the values.
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
    """Return a value with as many digits as anything found deserves."""
    return round(float(f"{value:.{_DIGITS}g}"), _DECIMALS)
