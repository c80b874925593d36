# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The summary of a flight for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration.text_tables import text_table

_LABEL = 20
_COLUMNS = ("p50", "p90", "p99", "max")
_ABSENT = "-"
_MAX_WAYPOINTS = 8  # errors at waypoints: a line of them
_TIMES = (
    ("solver iterations", "", "iterations", "{:.0f}"),
    ("solve time", "us", "solve_time_us", "{:.0f}"),
    ("control step", "us", "step_time_us", "{:.0f}"),
    ("odometry to command", "ms", "odom_to_command_ms", "{:.3f}"),
)


def summary_table(summary: Mapping[str, Any]) -> str:
    """Return the summary as lines of plain ASCII text, at most 80 columns wide."""
    s = summary
    last_errors = [f"{error:.3f}" for error in s["waypoint_error_m"][-_MAX_WAYPOINTS:]]
    rows = {
        "flight": f"{s['duration_s']:.2f} s"
        + _text(", {:.1f} x real time", s["realtime_factor"], absent=""),
        "commands": f"{s['commands']} for {s['odometries']} odometries, "
        f"{s['unanswered_odometries']} unanswered",
        "position error": _text(
            "RMSE {:.3f} m, max {:.3f} m", s["position_rmse_m"], s["position_max_m"]
        ),
        "error at waypoints": f"{' '.join(last_errors)} m" if last_errors else _ABSENT,
        **_gates_row(s),
        "attitude error": _text("RMSE {:.3f} rad", s["attitude_rmse_rad"]),
        "rates at bound": _text("{:.1%} of the commands", s["rate_saturation_fraction"]),
        "safety": f"{s['fallbacks']} fallbacks, {s['solver_failures']} solver failures, "
        f"{s['deadline_misses']} deadline misses",
    }
    if s.get("clearance_min_m") is not None:
        collided = ", COLLIDED" if s["collided"] else ""
        rows["obstacles"] = f"clearance at least {s['clearance_min_m']:.3f} m{collided}"
    lines = [f"{label:{_LABEL}}{text}" for label, text in rows.items()]
    return "\n".join((*lines, "", *_timing_rows(s)))


def _gates_row(s: Mapping[str, Any]) -> dict[str, str]:
    gates = s.get("gates")
    if not gates:
        return {}
    passed, clipped = (sum(gate[each] for gate in gates) for each in ("passed", "clipped"))
    lap_time = _text("{:.3f} s", s["lap_time_s"])
    return {"gates": f"{passed} of {len(gates)} passed, {clipped} clipped, lap {lap_time}"}


def _timing_rows(s: Mapping[str, Any]) -> list[str]:
    cells = [
        (label, unit, *(_text(style, s[name].get(column)) for column in _COLUMNS))
        for label, unit, name, style in _TIMES
    ]
    return text_table(
        [("", "", *_COLUMNS), *cells],
        align="llrrrr",
        widths=(_LABEL - 1, 4, 12, 12, 12, 12),
        gap=" ",
    )


def _text(style: str, *values: float | None, absent: str = _ABSENT) -> str:
    """Return formatted values, or the mark for data that was not recorded."""
    return absent if None in values else style.format(*values)
