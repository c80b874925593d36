"""A ROS parameter file of the vehicle for the controller: what was found, and what was kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from quad_mpc_ros.analysis.identification.result import Estimate
from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.control.config import MpcConfig

Kept = Literal["mass", "curve"]
"""What is kept of thrust per mass, of which only the quotient is observable."""

Entries = dict[str, tuple[Any, str]]
"""Values by the name of their parameter, each with a remark."""

KEPT, UNOBSERVABLE = "kept", "kept, not observable"
# What a reference must know of the vehicle as well.
_SHARED = (
    "mass",
    "gravity",
    "drag",
    "rotor_drag",
    "translational_lift",
    "motor_count",
    "thrust_curve",
)
_DIGITS, _DECIMALS = 4, 7  # of what is written


def found_entry(estimate: Estimate) -> tuple[float, str]:
    """Return a found value and how far off it may be."""
    return rounded(estimate.value), f"+- {estimate.half_width:.2g}"


def axes_entry(estimates: Sequence[Estimate | None], given: PerAxis) -> tuple[Any, str]:
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


def thrust_entries(scale: Estimate, given: MpcConfig, *, keep: Kept) -> Entries:
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


def content(
    entries: Mapping[str, tuple[Any, str]],
    given: MpcConfig,
    *,
    remarks: Sequence[str],
    shared: bool = False,
) -> str:
    """Return the text of the file, below ``remarks``; ``shared`` with the part of a reference.

    Raises ``ConfigurationError`` when the controller would refuse the values.
    """
    given.updated({name: value for name, (value, _) in entries.items()})
    lines = [*(f"# {remark}" for remark in remarks), *_section("mpc", entries)]
    if shared:
        lines += _section("reference", {name: entries[name] for name in _SHARED})
    return "\n".join(lines) + "\n"


def _section(node: str, entries: Mapping[str, tuple[Any, str]]) -> list[str]:
    return [
        f"/**/{node}:",
        "  ros__parameters:" + ("" if entries else " {}"),
        *(f"    {name}: {_written(value)}  # {note}" for name, (value, note) in entries.items()),
    ]


def rounded(value: float) -> float:
    """Return a value with as many digits as anything found deserves."""
    return round(float(f"{value:.{_DIGITS}g}"), _DECIMALS)


def _written(value: Any) -> str:
    """Return a value as YAML; to which 1e-07 is text."""
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_written, value))}]"
    return np.format_float_positional(value, trim="0") if isinstance(value, float) else str(value)
