"""What was measured as tables: the same rows for a terminal and for a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.bench.peers import PEERS, SWEPT
from quad_mpc_ros.text_tables import markdown_table, text_table

Rows = list[list[str]]
"""A header and the rows below it; the first cell of each is its label."""

_ABSENT = "-"
_PEER_HEADER = [
    "", "p50 [us]", "p99 [us]", "max [us]", "first [us]",
    "iterations p50 / p99 / max", "failed", "RMSE [m]", "before switch [m]",
]  # fmt: skip
_HORIZON_HEADER = [
    "N", "whole step of", "p50 [us]", "p99 [us]",
    "solver alone p50", "p99 [us]", "iterations p50 / p99 / max", "RMSE [m]",
]  # fmt: skip


def peer_rows(result: Mapping[str, Any]) -> Rows:
    """Return each peer's whole step, and below it what the parts of it took."""
    rows = [_PEER_HEADER]
    for entry in compared(result):
        kind = PEERS[entry["peer"]]
        rows.append(
            [
                kind.title,
                *_times(entry["step_us"], "p50", "p99", "max"),
                f"{entry['first_step_us']:.0f}",
                _iterations(entry),
                str(entry["failed_steps"]),
                _metres(entry["position_rmse_m"]),
                _metres(entry["error_before_switch_m"]),
            ]
        )
        if entry["mpc_us"]["p50"] is not None:
            rows.append(_part("of that, the MPC alone", entry["mpc_us"]))
        rows.append(_part(f"of that, {kind.solver}'s own time", entry["solve_us"]))
    return rows


def _part(label: str, times: Mapping[str, float | None]) -> list[str]:
    """Return a row that tells of a step only how long a part of it took."""
    return [label, *_times(times, "p50", "p99", "max"), *[""] * (len(_PEER_HEADER) - 4)]


def horizon_rows(result: Mapping[str, Any]) -> Rows:
    """Return the cost against the length of the horizon."""
    rows = [_HORIZON_HEADER]
    for entry in swept(result):
        rows.append(
            [
                str(entry["horizon_steps"]),
                PEERS[entry["peer"]].title,
                *_times(entry["step_us"], "p50", "p99"),
                *_times(entry["solve_us"], "p50", "p99"),
                _iterations(entry),
                _metres(entry["position_rmse_m"]),
            ]
        )
    return rows


def comparison_lines(result: Mapping[str, Any]) -> list[str]:
    """Return how this controller stands beside acados and beside its own solver."""
    found = {entry["peer"]: entry for entry in compared(result)}
    ours = found.get("controller")
    if ours is None:
        return []
    lines = [
        "Whole step over OSQP's own time: "
        f"{_ratio(ours['step_us'], ours['solve_us'], 'p50')} at p50; the MPC alone: "
        f"{_ratio(ours['mpc_us'], ours['solve_us'], 'p50')}."
    ]
    if "acados" in found:
        theirs = found["acados"]["step_us"]
        lines.append(
            f"Whole step over that of acados: {_ratio(ours['step_us'], theirs, 'p50')} at p50, "
            f"{_ratio(ours['step_us'], theirs, 'p99')} at p99."
        )
    return lines


def compared(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the entries of the table of peers."""
    steps = result["settings"]["horizon_steps"]
    return [entry for entry in result["entries"] if entry["horizon_steps"] == steps]


def swept(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the entries of the table against the horizon, by peer and length.

    There are none when only one length was flown.
    """
    entries = [entry for entry in result["entries"] if entry["peer"] in SWEPT]
    if len({entry["horizon_steps"] for entry in entries}) < 2:
        return []
    return sorted(entries, key=lambda entry: (SWEPT.index(entry["peer"]), entry["horizon_steps"]))


def as_text(rows: Rows) -> str:
    """Return rows as lines of plain text, the label to the left and numbers to the right."""
    return "\n".join(text_table(rows, align="l" + "r" * (len(rows[0]) - 1)))


def as_markdown(rows: Rows) -> str:
    """Return rows as a table of Markdown."""
    return markdown_table(rows[0], rows[1:], align="l" + "r" * (len(rows[0]) - 1))


def _times(values: Mapping[str, float | None], *names: str) -> list[str]:
    return [_ABSENT if (value := values[name]) is None else f"{value:.0f}" for name in names]


def _iterations(entry: Mapping[str, Any]) -> str:
    return " / ".join(_times(entry["iterations"], "p50", "p99", "max"))


def _metres(value: float | None) -> str:
    return _ABSENT if value is None else f"{value:.4f}"


def _ratio(over: Mapping[str, float | None], under: Mapping[str, float | None], name: str) -> str:
    numerator, denominator = over[name], under[name]
    return f"{numerator / denominator:.2f}" if numerator and denominator else _ABSENT
