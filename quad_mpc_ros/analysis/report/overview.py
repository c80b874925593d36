"""What runs are and how well they went, as HTML tables with a column a run."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from quad_mpc_ros.analysis.report.markup import html_table
from quad_mpc_ros.analysis.report.run import ReportedRun
from quad_mpc_ros.configuration import files
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.config import SimulatorConfig

_ABSENT = "–"
_NOT_RECORDED = "not recorded"
_SIMULATION_CLOCK_END = 946_684_800  # s, the year 2000: clocks of simulations begin at 0


def identity_table(runs: Sequence[ReportedRun]) -> str:
    """Return what each run is."""
    return _table(runs, {name: [text(run) for run in runs] for name, text in _RUN_ROWS.items()})


def metrics_table(runs: Sequence[ReportedRun]) -> str:
    """Return the figures of merit of each run, by their names in ``summary.json``."""
    figures = [
        dict(files.flattened({k: v for k, v in run.summary.items() if k not in _NO_FIGURES}))
        for run in runs
    ]
    names = dict.fromkeys(name for each in figures for name in each)
    return _table(runs, {name: [_figure(each.get(name)) for each in figures] for name in names})


def parameter_table(runs: Sequence[ReportedRun], *, only_different: bool) -> str:
    """Return the recorded parameters, or those in which runs differ; empty when there are none."""
    values = [_flattened(run.flight.parameters) for run in runs]
    rows = {
        name: [text_of(each[name]) if name in each else _ABSENT for each in values]
        for name in dict.fromkeys(name for each in values for name in each)
    }
    if only_different:
        rows = {name: cells for name, cells in rows.items() if len(set(cells)) > 1}
    return _table(runs, rows) if rows else ""


def _started(run: ReportedRun) -> str:
    seconds = int(run.flight.stamp_ns[0]) // 1_000_000_000
    if seconds < _SIMULATION_CLOCK_END:
        return "simulated time"
    moment = datetime.datetime.fromtimestamp(seconds, tz=datetime.UTC)
    return moment.strftime("%Y-%m-%d %H:%M:%S UTC")


def _reference(run: ReportedRun) -> str:
    recorded = recorded_parameters(run.flight.parameters, ReferenceConfig)
    return str(recorded.get("trajectory", _NOT_RECORDED))


def _controller(run: ReportedRun) -> str:
    if not any(name.rsplit("/", 1)[-1] == "mpc" for name in run.flight.parameters):
        return _NOT_RECORDED
    mpc = run.flight.mpc
    return (
        f"{mpc.formulation}, {mpc.horizon_steps} steps of {mpc.horizon_step:g} s "
        f"at {mpc.control_rate:g} Hz"
    )


def _vehicle(run: ReportedRun) -> str:
    recorded = recorded_parameters(run.flight.parameters, SimulatorConfig)
    if not recorded:
        return "no simulator recorded"
    # Not built: the plant may be another package's that is not installed here.
    simulated = {**SimulatorConfig().flattened(), **recorded}
    return f"simulated, {simulated['plant']}, {simulated['dynamics']}"


_RUN_ROWS: dict[str, Callable[[ReportedRun], str]] = {
    "bag": lambda run: str(run.bag),
    "start": _started,
    "duration": lambda run: f"{run.summary['duration_s']:.2f} s",
    "reference": _reference,
    "controller": _controller,
    "vehicle": _vehicle,
}

_NO_FIGURES = ("config", "commanding", "margins", "estimated", "gates")
"""What is in the parameters of the page, in its words and in its figures."""


def _figure(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_figure, value)) or _ABSENT
    return _ABSENT if value in (None, {}) else str(value)


def _flattened(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {
        f"{node}.{name}": value
        for node, values in sorted(parameters.items())
        for name, value in files.flattened(values)
    }


def _table(runs: Sequence[ReportedRun], rows: Mapping[str, Sequence[str]]) -> str:
    return html_table([run.name for run in runs], rows)
