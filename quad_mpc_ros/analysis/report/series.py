# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time series of a run as CSV tables with full precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from quad_mpc_ros.analysis.report.run import ReportedRun
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.recordings.evaluation.metrics import attitude_errors, position_errors

TABLE_NAMES = ("odometry", "commands", "ticks")

CsvColumns = dict[str, NDArray[Any]]


def csv_tables(run: ReportedRun) -> dict[str, str]:
    """Return the tables of :data:`TABLE_NAMES` as CSV with a header; units end the names.

    ``odometry`` has a row for each odometry, with the active reference and the errors;
    ``commands`` a row for each command, with the stamp of the answered odometry; ``ticks`` the
    values of ``mpc/stats``.
    """
    ticks = {"time_s": run.flight.tick_time, **run.flight.stats}
    tables = (_odometry(run), _commands(run), ticks)
    return {name: _csv(columns) for name, columns in zip(TABLE_NAMES, tables, strict=True)}


def _odometry(run: ReportedRun) -> CsvColumns:
    flight, reference = run.flight, run.flight.reference
    columns: CsvColumns = {
        "time_s": flight.time,
        "stamp_ns": flight.stamp_ns,
        **_vector("p_WB", flight.p_WB, "m"),
        **_vector("q_WB", flight.q_WB_xyzw),
        **_vector("v_WB_B", flight.v_WB_B, "m_s"),
        **_vector("w_WB_B", flight.w_WB_B, "rad_s"),
    }
    if reference is None:
        return columns
    return {
        **columns,
        **_vector("reference_p_WB", reference.p_WB, "m"),
        **_vector("reference_q_WB", so3.quaternion_xyzw_from_rotation(reference.R_WB)),
        **_vector("reference_v_WB_B", reference.v_WB_B, "m_s"),
        **_vector("reference_w_WB_B", reference.w_WB_B, "rad_s"),
        "reference_throttle": reference.throttle,
        "position_error_m": position_errors(flight),
        "attitude_error_rad": attitude_errors(flight),
    }


def _commands(run: ReportedRun) -> CsvColumns:
    commands = run.flight.commands
    return {
        "time_s": run.flight.time_of(commands.stamp_ns),
        "stamp_ns": commands.stamp_ns,
        "publish_time_ns": commands.publish_time_ns,
        "throttle": commands.throttle,
        **_vector("w_WB_B", commands.w_WB_B, "rad_s"),
    }


def _vector(name: str, values: Array, unit: str = "") -> CsvColumns:
    """Return the columns of vectors (n, 3) or quaternions (n, 4), x first."""
    ending = f"_{unit}" if unit else ""
    names = "xyzw"[: values.shape[1]]
    return {f"{name}_{axis}{ending}": values[:, i] for i, axis in enumerate(names)}


def _csv(columns: Mapping[str, NDArray[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()
