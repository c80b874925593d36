"""The summary of a flight for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from quad_mpc_ros.configuration.text_tables import text_table

_WIDTH = 80
_LABEL = 20
_COLUMNS = ("p50", "p90", "p99", "max")
_ABSENT = "-"
_MAX_WAYPOINTS = 8  # errors at waypoints: a line of them


def summary_table(summary: Mapping[str, Any]) -> str:
    """Return the summary as lines of plain ASCII text, at most 80 columns wide."""
    return "\n".join((*_flight_rows(summary), "", *_timing_rows(summary)))


def _flight_rows(s: Mapping[str, Any]) -> list[str]:
    rows = {
        "flight": f"{s['duration_s']:.2f} s"
        + _unless_absent(s["realtime_factor"], ", {:.1f} x real time", absent=""),
        "commands": f"{s['commands']} for {s['odometries']} odometries, "
        f"{s['unanswered_odometries']} unanswered",
        "position error": _unless_absent(s["position_rmse_m"], "RMSE {:.3f} m")
        + _unless_absent(s["position_max_m"], ", max {:.3f} m", absent=""),
        "error at waypoints": _waypoint_errors(s["waypoint_error_m"]),
        **_race_row(s),
        "attitude error": _unless_absent(s["attitude_rmse_rad"], "RMSE {:.3f} rad"),
        "rates at bound": _unless_absent(s["rate_saturation_fraction"], "{:.1%} of the commands"),
        "safety": f"{s['fallbacks']} fallbacks, {s['solver_failures']} solver failures, "
        f"{s['deadline_misses']} deadline misses",
    }
    if s.get("clearance_min_m") is not None:
        rows["obstacles"] = f"{s['clearance_min_m']:.3f} m from its surface at least" + (
            ", COLLIDED" if s["collided"] else ""
        )
    return [
        line
        for label, text in rows.items()
        for line in textwrap.wrap(
            text, _WIDTH, initial_indent=label.ljust(_LABEL), subsequent_indent=" " * _LABEL
        )
    ]


def _race_row(s: Mapping[str, Any]) -> dict[str, str]:
    gates = s.get("gates")
    if not gates:
        return {}
    passed = sum(gate["passed"] for gate in gates)
    misses = [gate["miss_m"] for gate in gates if gate["miss_m"] is not None]
    text = f"{passed} of {len(gates)} passed, {sum(gate['clipped'] for gate in gates)} clipped"
    if misses:
        text += f", at most {max(misses):.3f} m from the centre"
    text += _unless_absent(s["lap_time_s"], "; lap {:.3f} s", absent="")
    return {
        "gates": text + _unless_absent(s.get("behind_max_s"), ", {:.2f} s given up", absent="")
    }


def _timing_rows(s: Mapping[str, Any]) -> list[str]:
    rows = (
        ("solver iterations", "", s["iterations"], "{:.0f}"),
        ("solve time", "us", s["solve_time_us"], "{:.0f}"),
        ("control step", "us", s["step_time_us"], "{:.0f}"),
        ("odometry to command", "ms", s["odom_to_command_ms"], "{:.3f}"),
    )
    cells = [
        (label, unit, *(_unless_absent(values.get(column), style) for column in _COLUMNS))
        for label, unit, values, style in rows
    ]
    return text_table(
        [("", "", *_COLUMNS), *cells],
        align="llrrrr",
        widths=(_LABEL - 1, 4, 12, 12, 12, 12),
        gap=" ",
    )


def _waypoint_errors(errors: Sequence[float]) -> str:
    if not errors:
        return _ABSENT
    shown = " ".join(f"{error:.3f}" for error in errors[-_MAX_WAYPOINTS:])
    if len(errors) <= _MAX_WAYPOINTS:
        return f"{shown} m"
    return f"{shown} m, the last {_MAX_WAYPOINTS} of {len(errors)}; worst {max(errors):.3f} m"


def _unless_absent(value: float | None, style: str, *, absent: str = _ABSENT) -> str:
    """Return a value in the format ``style``, or what stands for one that there is no data for."""
    return absent if value is None else style.format(value)
