"""Commands of a controller against the recorded ones: how many are equal, how far others are."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.figures.over_time import write_panels
from quad_mpc_ros.analysis.figures.panels import Curve, Panel
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.recordings.evaluation.commanding import FALLBACKS
from quad_mpc_ros.recordings.evaluation.metrics import NOT_FAILED
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

CHANNELS = ("throttle", "rate_x", "rate_y", "rate_z")
_UNITS = ("", "rad/s", "rad/s", "rad/s")
_FIGURES = ("solve_time_us", "step_time_us", "iterations")

_LABEL_SIZE, _CELL_SIZE = 28, 10


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandComparison:
    """Commands to the same n odometries, throttle and rates (n, 4), by their stamps (n,).

    ``only_recorded`` and ``only_resolved`` count those that the other has none for. The figures
    of the ticks are arrays by their name in :class:`TickStats`; empty where none were recorded.
    """

    stamp_ns: NDArray[np.int64]
    recorded: Array
    resolved: Array
    only_recorded: int
    only_resolved: int
    recorded_stats: Mapping[str, NDArray[Any]]
    resolved_stats: Mapping[str, NDArray[Any]]

    @property
    def equal(self) -> int:
        """Count the commands that are the same, bit for bit."""
        same = self.recorded.view(np.int64) == self.resolved.view(np.int64)
        return int(np.count_nonzero(np.all(same, axis=1)))

    def summary(self) -> dict[str, Any]:
        """Return the figures as they are written to JSON, what there is no data for as None."""
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
                for i, name in enumerate(CHANNELS)
            },
            "recorded": _figures(self.recorded_stats),
            "resolved": _figures(self.resolved_stats),
        }


def compare_commands(
    recorded: Sequence[CommandSample],
    resolved: Sequence[CommandSample],
    *,
    recorded_stats: Sequence[TickStats],
    resolved_stats: Sequence[TickStats],
) -> CommandComparison:
    """Compare commands by the stamps they answer; of those of one stamp the first counts."""
    before, after = _by_stamp(recorded), _by_stamp(resolved)
    shared = sorted(before.keys() & after.keys())
    return CommandComparison(
        stamp_ns=np.array(shared, dtype=np.int64),
        recorded=np.array([before[stamp] for stamp in shared]).reshape(-1, 4),
        resolved=np.array([after[stamp] for stamp in shared]).reshape(-1, 4),
        only_recorded=len(before.keys() - after.keys()),
        only_resolved=len(after.keys() - before.keys()),
        recorded_stats=_as_arrays(recorded_stats),
        resolved_stats=_as_arrays(resolved_stats),
    )


def comparison_table(comparison: CommandComparison) -> str:
    """Return the comparison as lines of plain ASCII text, at most 80 columns wide."""
    s = comparison.summary()
    alone = f"{s['only_recorded']} recorded, {s['only_resolved']} resolved"
    facts = [
        ("commands", f"{s['equal']} of {s['compared']} equal, bit for bit"),
        ("without counterpart", alone),
    ]
    numbers: list[list[str]] = [[], ["difference", "rms", "p50", "p99", "max"]]
    for name, unit in zip(CHANNELS, _UNITS, strict=True):
        label = f"  {name} [{unit}]" if unit else f"  {name}"
        values = [s["difference"][name][key] for key in ("rms", "p50", "p99", "max")]
        numbers.append([label, *(_shown(value, "{:.3g}") for value in values)])
    numbers += [[], ["", "p50", "p90", "p99", "max"]]
    labels = ("solve time [us]", "control step [us]", "solver iterations")
    for label, figure in zip(labels, _FIGURES, strict=True):
        for which in ("recorded", "resolved"):
            values = [s[which][figure][key] for key in ("p50", "p90", "p99", "max")]
            numbers.append([f"{label:<18}{which}", *(_shown(value, "{:.0f}") for value in values)])
    failures = "{fallbacks} fallbacks, {solver_failures} solver failures"
    ends = [(which, failures.format_map(s[which])) for which in ("recorded", "resolved")]
    return "\n".join(
        (
            *text_table(facts, align="ll", widths=(_LABEL_SIZE - 1, 0), gap=" "),
            *text_table(numbers, align="lrrrr", widths=(_LABEL_SIZE, *[_CELL_SIZE] * 4), gap=" "),
            *text_table(ends, align="ll", widths=(_LABEL_SIZE - 1, 0), gap=" "),
        )
    )


def write_command_comparison(comparison: CommandComparison, path: Path) -> Path:
    """Draw both commands, and below them their differences, over time into a PNG.

    Raises ``OSError`` if it cannot be written.
    """
    time = np.asarray((comparison.stamp_ns - comparison.stamp_ns[:1]) * 1e-9)
    held = functools.partial(Curve, time=time, held=True)
    commands, differences = [], []
    quantities = (("throttle", "", ""), *(("ω", axis, "rad/s") for axis in "xyz"))
    for i, (name, subscript, unit) in enumerate(quantities):
        recorded, resolved = comparison.recorded[:, i], comparison.resolved[:, i]
        curves = [
            held(name="recorded", values=recorded, colour=style.REFERENCE, weight="broad"),
            held(name="resolved", values=resolved),
        ]
        commands.append(Panel(name=name, subscript=subscript, unit=unit, curves=curves))
        off = [held(name="difference", values=resolved - recorded)]
        differences.append(Panel(name=f"Δ{name}", subscript=subscript, unit=unit, curves=off))
    title = f"Commands, {comparison.equal} of {len(time)} equal"
    return write_panels(title, [*commands, *differences], path)


def _by_stamp(commands: Sequence[CommandSample]) -> dict[int, Array]:
    first: dict[int, Array] = {}
    for command in commands:
        first.setdefault(command.stamp_ns, np.array([command.throttle, *command.w_WB_B]))
    return first


def _as_arrays(ticks: Sequence[TickStats]) -> dict[str, NDArray[Any]]:
    """Return the figures needed here; a tick that was published twice counts once."""
    once = list({tick.stamp_ns: tick for tick in reversed(ticks)}.values())
    kinds = dict.fromkeys(_FIGURES, np.float64) | {"solver_status": np.str_, "source": np.str_}
    return {
        name: np.array([getattr(tick, name) for tick in once], dtype=kind)
        for name, kind in kinds.items()
    }


def _figures(stats: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    ran = stats["solver_status"] != "not run"
    return {
        "ticks": len(ran),
        **{name: percentiles(stats[name][ran], 50, 90, 99) for name in _FIGURES},
        "fallbacks": int(np.sum(np.isin(stats["source"], FALLBACKS))),
        "solver_failures": int(np.sum(~np.isin(stats["solver_status"], NOT_FAILED))),
    }


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
