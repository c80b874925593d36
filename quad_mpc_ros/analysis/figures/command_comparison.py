# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the commands of a controller with the recorded commands."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.figures.over_time import PanelColumn, write_panels
from quad_mpc_ros.analysis.figures.panels import Curve, Panel
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

_CHANNELS = {"throttle": "", "rate_x": "rad/s", "rate_y": "rad/s", "rate_z": "rad/s"}


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandComparison:
    """Commands for the same n odometries, throttle and body rates (n, 4), by stamp (n,) [ns].

    ``only_recorded`` and ``only_resolved`` count the commands without a counterpart.
    """

    stamp_ns: NDArray[np.int64]
    recorded: Array
    resolved: Array
    only_recorded: int
    only_resolved: int

    @property
    def equal(self) -> int:
        """Number of commands that are identical bit for bit."""
        same = self.recorded.view(np.int64) == self.resolved.view(np.int64)
        return int(np.count_nonzero(np.all(same, axis=1)))

    def summary(self) -> dict[str, Any]:
        """Return counts and differences of each channel for JSON; missing values are None."""
        off = np.abs(self.resolved - self.recorded)
        return {
            "compared": len(self.stamp_ns),
            "equal": self.equal,
            "only_recorded": self.only_recorded,
            "only_resolved": self.only_resolved,
            "difference": {
                name: {
                    "rms": float(np.sqrt(np.mean(off[:, i] ** 2))) if len(off) else None,
                    **percentiles(off[:, i], 50, 99),
                }
                for i, name in enumerate(_CHANNELS)
            },
        }


def compare_commands(
    recorded: Sequence[CommandSample], resolved: Sequence[CommandSample]
) -> CommandComparison:
    """Compare commands with equal stamps; the first of duplicate stamps is used."""
    before, after = _by_stamp(recorded), _by_stamp(resolved)
    shared = sorted(before.keys() & after.keys())
    return CommandComparison(
        stamp_ns=np.array(shared, dtype=np.int64),
        recorded=np.array([before[stamp] for stamp in shared]).reshape(-1, 4),
        resolved=np.array([after[stamp] for stamp in shared]).reshape(-1, 4),
        only_recorded=len(before.keys() - after.keys()),
        only_resolved=len(after.keys() - before.keys()),
    )


def comparison_table(comparison: CommandComparison) -> str:
    """Return the comparison as lines of plain ASCII text, at most 80 columns wide."""
    summary = comparison.summary()
    columns = ("rms", "p50", "p99", "max")
    rows: list[Sequence[str]] = [("difference", *columns)]
    for name, unit in _CHANNELS.items():
        values = (summary["difference"][name][column] for column in columns)
        cells = ("-" if value is None else f"{value:.3g}" for value in values)
        rows.append((f"{name} [{unit}]" if unit else name, *cells))
    return "\n".join(
        (
            f"{summary['equal']} of {summary['compared']} commands are equal, bit for bit",
            f"without counterpart: {summary['only_recorded']} recorded, "
            f"{summary['only_resolved']} resolved",
            "",
            *text_table(rows, align="lrrrr"),
        )
    )


def write_command_comparison(comparison: CommandComparison, path: Path) -> Path:
    """Draw both commands, and below them their differences, over time into a PNG.

    Raises ``OSError`` if the file cannot be written.
    """
    time = np.asarray((comparison.stamp_ns - comparison.stamp_ns[:1]) * 1e-9)
    held = functools.partial(Curve, time=time, held=True)
    commands, differences = [], []
    quantities = (("throttle", "", ""), *(("ω", axis, "rad/s") for axis in "xyz"))
    for i, (name, subscript, unit) in enumerate(quantities):
        recorded, resolved = comparison.recorded[:, i], comparison.resolved[:, i]
        curves = [
            held(name="recorded", values=recorded, colour=style.REFERENCE, broad=True),
            held(name="resolved", values=resolved),
        ]
        commands.append(Panel(name=name, subscript=subscript, unit=unit, curves=curves))
        off = [held(name="difference", values=resolved - recorded)]
        differences.append(Panel(name=f"Δ{name}", subscript=subscript, unit=unit, curves=off))
    title = f"Commands, {comparison.equal} of {len(time)} equal"
    return write_panels([PanelColumn(title=title, panels=[*commands, *differences])], path)


def _by_stamp(commands: Sequence[CommandSample]) -> dict[int, Array]:
    first: dict[int, Array] = {}
    for command in commands:
        first.setdefault(command.stamp_ns, np.array([command.throttle, *command.w_WB_B]))
    return first
