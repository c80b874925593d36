"""The measurements of ``bench/performance.py`` as tables and as a page of documentation."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from markdown_table import markdown_table
from peers.peer import PeerKind

_PEER_HEADER = (
    "", "p50 [us]", "p99 [us]", "max [us]", "first [us]",
    "iterations p50 / p99 / max", "failed", "RMSE [m]",
)  # fmt: skip
_HORIZON_HEADER = (
    "N", "whole step of", "p50 [us]", "p99 [us]",
    "solver alone p50", "p99 [us]", "iterations p50 / p99 / max", "RMSE [m]",
)  # fmt: skip

Record = Mapping[str, Any]
Kinds = Mapping[str, PeerKind]


def page(record: Record, kinds: Kinds) -> str:
    """Return the page of a record."""
    parts = [
        "# Performance",
        _paragraph(
            "What a control step costs, next to other ways to solve the same problem. `make "
            "bench` measured all figures in one process and one run (`bench/performance.py`)."
        ),
        _paragraph(_how(record["settings"])),
        tables(record, kinds),
        "## What is compared",
        "\n".join(
            _paragraph(f"- **{name}**: {kind.description}", indent="  ")
            for name, kind in kinds.items()
        ),
        "## A whole flight",
        _paragraph(_WHOLE_FLIGHT),
        "## Machine",
        markdown_table(("", "measured on"), list(record["machine"].items())),
    ]
    return "\n\n".join(parts) + "\n"


def tables(record: Record, kinds: Kinds) -> str:
    """Return the comparison of the peers, and the cost against the length of the horizon."""
    own = record["settings"]["horizon_steps"]
    compared = [entry for entry in record["entries"] if entry["horizon_steps"] == own]
    swept = [entry for entry in record["entries"] if kinds[entry["peer"]].swept]
    parts = [
        markdown_table(_PEER_HEADER, _peer_rows(compared, kinds), align="lrrrrrrr"),
        *map(_paragraph, _ratios(compared)),
        _paragraph(_LEGEND),
    ]
    if len(swept) > len({entry["peer"] for entry in swept}):
        rows = _horizon_rows(swept, kinds)
        parts += [
            "## Against the length of the horizon",
            markdown_table(_HORIZON_HEADER, rows, align="llrrrrrr"),
        ]
    return "\n\n".join(parts)


def _peer_rows(compared: list[Record], kinds: Kinds) -> list[list[str]]:
    """Return each peer's whole step, and below it the times of its parts."""
    rows = []
    for entry in compared:
        kind = kinds[entry["peer"]]
        rows.append(
            [
                kind.title,
                *_times(entry["step_us"], "p50", "p99", "max"),
                f"{entry['first_step_us']:.0f}",
                _iterations(entry),
                str(entry["failed_steps"]),
                f"{entry['position_rmse_m']:.4f}",
            ]
        )
        parts = {f"of that, {kind.solver}'s own time": entry["solve_us"]}
        if entry["mpc_us"]["p50"] is not None:
            parts = {"of that, the MPC alone": entry["mpc_us"], **parts}
        for label, times in parts.items():
            rows.append([label, *_times(times, "p50", "p99", "max"), "", "", "", ""])
    return rows


def _horizon_rows(swept: list[Record], kinds: Kinds) -> list[list[str]]:
    order = list(kinds)
    return [
        [
            str(entry["horizon_steps"]),
            kinds[entry["peer"]].title,
            *_times(entry["step_us"], "p50", "p99"),
            *_times(entry["solve_us"], "p50", "p99"),
            _iterations(entry),
            f"{entry['position_rmse_m']:.4f}",
        ]
        for entry in sorted(
            swept, key=lambda entry: (order.index(entry["peer"]), entry["horizon_steps"])
        )
    ]


def _ratios(compared: list[Record]) -> list[str]:
    """Return the times of this controller over those of its solver and of acados."""
    found = {entry["peer"]: entry for entry in compared}
    ours, theirs = found["controller"], found.get("acados")
    solver = ours["solve_us"]
    lines = [
        f"Whole step over OSQP's own time: {_ratio(ours['step_us'], solver, 'p50')} at p50; the "
        f"MPC alone: {_ratio(ours['mpc_us'], solver, 'p50')}."
    ]
    if theirs is not None:
        both = (ours["step_us"], theirs["step_us"])
        lines.append(
            f"Whole step over that of acados: {_ratio(*both, 'p50')} at p50, "
            f"{_ratio(*both, 'p99')} at p99."
        )
    return lines


def _ratio(over: Mapping[str, float], under: Mapping[str, float], name: str) -> str:
    return f"{over[name] / under[name]:.2f}"


def _times(values: Mapping[str, float], *names: str) -> list[str]:
    return [f"{values[name]:.0f}" for name in names]


def _iterations(entry: Record) -> str:
    return " / ".join(_times(entry["iterations"], "p50", "p99", "max"))


_LEGEND = (
    "A whole step is odometry and reference in to command out, called from Python, for every peer "
    "by the same clock. The first step of each flight, on which solvers set themselves up, is not "
    "in p50, p99 and max; *first* is the longest of those. Iterations are summed over the solves "
    "of a step, of all steps. RMSE is of the worst flight and counts the jumps of the reference. "
    "OSQP's own time is the floor "
    "for what is built around OSQP. The MPC alone predicts, linearises, updates the QP, solves "
    "and applies; validation, safety ladder and limits, which no other peer has, are the rest."
)

_WHOLE_FLIGHT = (
    "`python bench/closed_loop.py` prints how many times real time flights take that are "
    "simulated in one process, as a campaign flies them, and where the time of a step goes: the "
    "MPC, the controller around it, and plant, sensors and reference."
)


def _how(settings: Record) -> str:
    s = settings
    return (
        f"The {s['trajectory']} on the plant `{s['dynamics']}`, {s['duration_s']:g} s at "
        f"{s['odom_rate_hz']:g} Hz, each peer {s['repeats']} times in turns, "
        f"N = {s['horizon_steps']} steps of {s['horizon_step_s']:g} s, "
        f"Q = diag({_numbers(s['Q'])}), R = diag({_numbers(s['R'])}), terminal weight "
        f"{s['terminal_weight']:g}, OSQP's tolerance {s['solver_tolerance']:g}. Each peer flies "
        "its own closed loop; the garbage collector is on, and is run before each flight."
    )


def _numbers(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _paragraph(text: str, *, indent: str = "") -> str:
    return textwrap.fill(
        text, 99, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
