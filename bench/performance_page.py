# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
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
    "N", "peer", "p50 [us]", "p99 [us]", "RMSE [m]",
)  # fmt: skip

Record = Mapping[str, Any]
Kinds = Mapping[str, PeerKind]


def page(record: Record, kinds: Kinds) -> str:
    """Return the page of a record."""
    parts = [
        "# Performance",
        "## Control step",
        _paragraph(_how(record)),
        tables(record, kinds),
        "### Peers",
        "\n".join(
            _paragraph(f"- **{name}:** {kind.description}", indent="  ")
            for name, kind in kinds.items()
        ),
        _OTHER_MEASUREMENTS.strip(),
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
            "### Horizon length",
            markdown_table(_HORIZON_HEADER, rows, align="llrrr"),
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
        parts = {f"– {kind.solver} alone": entry["solve_us"]}
        if entry["mpc_us"]["p50"] is not None:
            parts = {"– MPC alone": entry["mpc_us"], **parts}
        for label, times in parts.items():
            rows.append([label, *_times(times, "p50", "p99", "max"), "", "", "", ""])
    return rows


def _horizon_rows(swept: list[Record], kinds: Kinds) -> list[list[str]]:
    order = list(kinds)
    return [
        [
            str(entry["horizon_steps"]),
            entry["peer"],
            *_times(entry["step_us"], "p50", "p99"),
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
        f"Step time relative to OSQP alone: {_ratio(ours['step_us'], solver, 'p50')} at p50; MPC "
        f"alone: {_ratio(ours['mpc_us'], solver, 'p50')}."
    ]
    if theirs is not None:
        both = (ours["step_us"], theirs["step_us"])
        lines.append(
            f"Step time relative to acados: {_ratio(*both, 'p50')} at p50, "
            f"{_ratio(*both, 'p99')} at p99."
        )
    return lines


def _ratio(over: Mapping[str, float], under: Mapping[str, float], name: str) -> str:
    return f"{over[name] / under[name]:.2f}"


def _times(values: Mapping[str, float], *names: str) -> list[str]:
    return [f"{values[name]:.0f}" for name in names]


def _iterations(entry: Record) -> str:
    return " / ".join(_times(entry["iterations"], "p50", "p99", "max"))


_NOT_SHOWN = ("load before the run", "kernel")

_LEGEND = (
    "A step takes odometry and reference and returns a command, called from Python. *first* is "
    "the longest first step of a flight; the other columns exclude it. Iterations are the sum "
    "over the solves of a step. The RMSE includes the jumps of the reference. *MPC alone* "
    "excludes validation, failsafe and limits, which acados and cvxpy do not have."
)

_OTHER_MEASUREMENTS = """
With soft constraints in both (limits of tilt and speed, 2026-11-23), the step time relative to
acados is 0.42 to 0.48 at p50 and 0.70 to 0.93 at p99.

## Nodes over DDS

`python bench/node_latency.py --duration 25`, 2026-11-25: time from odometry to command. The relay
is an rclpy node without computation.

| rate | MPC p50 / p99 [ms] | relay p50 / p99 [ms] |
|---|---|---|
| 50 Hz | 1.71 / 2.93 | 1.42 / 3.43 |
| 200 Hz | 1.17 / 2.47 (0.04 % late by a period) | 0.60 / 2.39 |

- **Processor:** MPC 10 %, relay 4 % of a core at 50 Hz. The MPC is configured after 1.1 s.
- **Memory:** MPC 240, simulator 203, reference 80, recorder 78 MiB. The MPC's memory grows by
  0.4 MB in 30 minutes (`make soak`, 2026-11-22).
- **Vehicles** on two cores (60 s of a square with every node as a process, 2026-11-23): with five,
  99.95 % of the commands come within a period, with eight 97.5 %.

## Simulation speed

Times real time in one process, `python bench/closed_loop.py --duration 12`, 2026-11-22 to
2026-11-24: hover 88, square 79, hover with lags, delay, gusts and noise 42, at 200 Hz 12. The
plant `rotors` reaches 65 to 74, `betaflight` 5, `rotorpy` 0.5.

**Campaigns:** 500 hovers of 12 s take 42 s with two workers: 7 flights per second and core. More
workers than cores bring no speedup. The overhead is 2.1 ms per flight and 2.5 s at the start
(`python bench/campaign_cost.py`, 2026-11-24).
"""


def _how(record: Record) -> str:
    s = record["settings"]
    machine = [each for each in record["machine"].items() if each[0] not in _NOT_SHOWN]
    return (
        "`make bench` compares a control step with other solvers of the same problem. Setup: "
        f"{', '.join(' '.join(each) for each in machine)}. Flights: the "
        f"{s['trajectory']} on `{s['dynamics']}`, {s['duration_s']:g} s at "
        f"{s['odom_rate_hz']:g} Hz, {s['repeats']} flights of each peer in turns. "
        f"Problem: N = {s['horizon_steps']} steps of {s['horizon_step_s']:g} s, "
        f"Q = diag({_numbers(s['Q'])}), R = diag({_numbers(s['R'])}), terminal weight "
        f"{s['terminal_weight']:g}, tolerance of OSQP {s['solver_tolerance']:g}."
    )


def _numbers(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _paragraph(text: str, *, indent: str = "") -> str:
    return textwrap.fill(
        text, 119, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
