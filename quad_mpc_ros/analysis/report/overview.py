# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""HTML tables of runs, with a column for each run."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from quad_mpc_ros.analysis.report.run import ReportedRun
from quad_mpc_ros.configuration import files
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.references.config import ReferenceConfig

_ABSENT = "–"
_SHOWN_ELSEWHERE = ("config", "gates")
_SIMULATION_CLOCK_END = 946_684_800  # s, the year 2000: clocks of simulations begin at 0


def identity_table(runs: Sequence[ReportedRun]) -> str:
    """Return bag, start and reference of each run."""
    rows: dict[str, Callable[[ReportedRun], str]] = {
        "bag": lambda run: str(run.bag),
        "start": _start,
        "reference": _reference,
    }
    return _table(runs, {name: [text(run) for run in runs] for name, text in rows.items()})


def metrics_table(runs: Sequence[ReportedRun]) -> str:
    """Return the metrics of each run, keyed by their names in ``summary.json``."""
    metrics = [
        dict(files.flattened({k: v for k, v in run.summary.items() if k not in _SHOWN_ELSEWHERE}))
        for run in runs
    ]
    names = dict.fromkeys(name for each in metrics for name in each)
    return _table(runs, {name: [_value(each.get(name)) for each in metrics] for name in names})


def parameter_table(runs: Sequence[ReportedRun], *, only_different: bool) -> str:
    """Return the recorded parameters, or the differing ones of several runs; empty without any."""
    values = [_flattened(run.flight.parameters) for run in runs]
    rows = {
        name: [text_of(each[name]) if name in each else _ABSENT for each in values]
        for name in dict.fromkeys(name for each in values for name in each)
    }
    if only_different:
        rows = {name: cells for name, cells in rows.items() if len(set(cells)) > 1}
    return _table(runs, rows) if rows else ""


def _start(run: ReportedRun) -> str:
    seconds = int(run.flight.stamp_ns[0]) // 1_000_000_000
    if seconds < _SIMULATION_CLOCK_END:
        return "simulated time"
    moment = datetime.datetime.fromtimestamp(seconds, tz=datetime.UTC)
    return moment.strftime("%Y-%m-%d %H:%M:%S UTC")


def _reference(run: ReportedRun) -> str:
    recorded = recorded_parameters(run.flight.parameters, ReferenceConfig)
    return str(recorded.get("trajectory", "not recorded"))


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_value, value)) or _ABSENT
    return _ABSENT if value in (None, {}) else str(value)


def _flattened(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {
        f"{node}.{name}": value
        for node, values in sorted(parameters.items())
        for name, value in files.flattened(values)
    }


def _table(runs: Sequence[ReportedRun], rows: Mapping[str, Sequence[str]]) -> str:
    """Return a table of text, escaped here; ``rows`` are the cells, keyed by row heading."""
    lines = {"": [run.name for run in runs], **rows}
    return "\n".join(
        (
            "<table>",
            *(
                f"<tr><th>{escape(name)}</th>"
                + "".join(f"<td>{escape(cell)}</td>" for cell in cells)
                + "</tr>"
                for name, cells in lines.items()
            ),
            "</table>",
        )
    )
