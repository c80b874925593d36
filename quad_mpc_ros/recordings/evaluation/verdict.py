# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Verdict on a flight from its summary: success, problems, and next steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.control.config import MPC
from quad_mpc_ros.control.safety.odometry_gate import SLOW
from quad_mpc_ros.recordings.evaluation.commanding import WITHOUT_MPC
from quad_mpc_ros.recordings.evaluation.crash import crash_text

Summary = Mapping[str, Any]
_Finding = tuple[str, str]  # what went wrong, and what to do next; either may be empty

_MAX_SATURATED_RATIO = 0.05  # of the commands
_MAX_THRUST_ERROR, _MAX_LAG_ERROR = 0.1, 0.25  # of the configured value
_MAX_RMSE = 0.5  # m RMSE from a reference that does not jump
_MIN_LAG_CHANGE = 5.0  # ms; a difference below is not worth a flight
_TIGHT_STEP_RATIO = 0.5  # of a control period, at p99
_LAGS = ("rate_time_constant_ms", "yaw_time_constant_ms", "thrust_time_constant_ms")

_COUNTS = {
    "solver_failures": ("Solves without a solution", ""),
    "stage_errors": (
        "Errors inside the controller",
        "Report the errors in the log, with the bag: they are defects.",
    ),
    "unanswered_odometries": ("Odometries without a command", ""),
    "rejected_inputs": (
        "Odometries and references rejected as unusable",
        "Read in the log why messages were rejected (docs/reference/diagnostics.md).",
    ),
    "estimate_resets": ("Resets of an estimate that did not fit the vehicle", ""),
}
_FAILSAFE_ADVICE = {
    "disagree": "Correct frames, signs and units of the odometry (docs/explanation/safety.md).",
    "do not lift": "Check motors, battery, mass and thrust_curve "
    "(docs/tutorials/first_flight.md).",
    "the vehicle oscillates": "Raise lags or delay by half, or fly default (docs/howto/tune.md).",
    "the controller": "Correct the controller (docs/tutorials/your_controller.md).",
    "solver": "Increase advanced.solver.max_iterations (docs/howto/tune.md).",
    "": "Look up the reason and fix it (docs/reference/diagnostics.md).",
}
"""Advice for each reason for a failsafe, keyed by a part of the reason."""
_TOO_FAST_ADVICE = (
    "Slow the reference down with reference.time_scaling: auto or with its other parameters "
    "(docs/howto/references.md)."
)
_MISSED_ADVICE = (
    "Fly longer (--duration), or keep obstacles, fence and limits away from the reference "
    "(docs/howto/references.md)."
)
_CRASH_ADVICE = (
    "Do not fly a vehicle with this configuration: quad_mpc rehearse reports what a "
    "configuration tolerates (docs/tutorials/first_flight.md)."
)
_TIME_ADVICE = (
    "Give the MPC more time: fewer mpc.horizon_steps, or a real-time priority "
    "(docs/howto/troubleshooting.md)."
)
_SATURATION_ADVICE = (
    "Raise R of the body rates, or omega_max if the loop permits (docs/howto/tune.md)."
)
_MODEL_ADVICE = "Correct the model: run quad_mpc identify on this flight (docs/howto/identify.md)."


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A summary in sentences.

    Attributes:
        good: Whether the flight completed its task, the MPC sent every command, every solve had a
            solution, nothing crashed.
        line: The outcome in one line.
        wrong: The problems.
        advice: Next steps, each with the page that explains it.
    """

    good: bool
    line: str
    wrong: Sequence[str]
    advice: Sequence[str]


def verdict_on(summary: Summary) -> Verdict:
    """Return the verdict on the summary of a flight (:func:`.metrics.summarise`)."""
    s, commanded = summary, _commanded(summary)
    task = list(_task_findings(s))
    found = [*task, *_controller_findings(s), *_timing_findings(s), *_tracking_findings(s)]
    wrong = [what for what, _ in found if what]
    led_to_crash = list(_failsafe_findings(s)) if _failsafe_before_crash(s) else []
    # What else went wrong may be a consequence of a crash.
    relevant = [*led_to_crash, *task] if s["crashed"] else found
    advice = dict.fromkeys(to_do for _, to_do in relevant if to_do)
    if s["crashed"]:
        line = f"{wrong[0]} {commanded}" if led_to_crash else wrong[0]
    elif not s["commands"] or _without_mpc(s):
        line = commanded
    else:
        line = f"{commanded} {wrong[0] if wrong else 'Nothing went wrong.'}"
    failed = _without_mpc(s) or s["solver_failures"] or s["crashed"]
    failed = failed or s["stage_errors"] or s["missed"]
    return Verdict(
        good=bool(s["commands"] and not failed),
        line=line,
        wrong=wrong,
        advice=list(advice) or ["No problems found."],
    )


def _commanded(s: Summary) -> str:
    """Return the active sources, and the first reason for a source other than the MPC."""
    ticks, without = s["commanding"]["ticks"], _without_mpc(s)
    first = s["commanding"]["first_without_mpc"]
    if not s["commands"]:
        reason = first["reason"] if first else ""
        return f"No command was sent. {reason or 'See the solver status in mpc/stats'}."
    if not ticks:
        return f"{s['commands']} commands; their source was not recorded."
    if without:
        counts = ", ".join(f"{count} {source}" for source, count in without.items())
        return (
            f"{_name(s)} was not active at {sum(without.values())} of {sum(ticks.values())} "
            f"ticks: {counts}. First at {first['time_s']:.2f} s: {first['reason']}."
        )
    due = s["commands"] + s["unanswered_odometries"]
    if due > s["commands"]:
        return f"{_name(s)} sent {s['commands']} of the {due} commands that were due."
    return f"{_name(s)} sent all {due} commands."


def _name(s: Summary) -> str:
    """Return the controller as the subject of a sentence."""
    name = s["config"].get("mpc", {}).get("controller", MPC)
    return "The MPC" if name == MPC else f"The controller {name}"


def _without_mpc(s: Summary) -> dict[str, int]:
    """Return the ticks of other sources while the MPC was or should have been active."""
    ticks = s["commanding"]["ticks"]
    return {source: ticks[source] for source in WITHOUT_MPC if ticks.get(source)}


def _task_findings(s: Summary) -> Iterator[_Finding]:
    """Yield crash, collision and missed tasks."""
    if s["beyond_limits"] and (s["crashed"] or s["missed"]):
        yield "", f"{' '.join(s['beyond_limits'])} {_TOO_FAST_ADVICE}"
    if s["crashed"]:
        text = crash_text(s["crash"], s["crash_time_s"])
        yield f"{text.capitalize()}.", _CRASH_ADVICE
    if s.get("collision"):
        x, y, z = s["collision"]["position_m"]
        speed = s["collision"]["speed_m_s"]
        yield f"Collision at ({x:.2f}, {y:.2f}, {z:.2f}) m with {speed:.2f} m/s.", ""
    for missed in s["missed"]:
        yield missed, "" if s["crashed"] else _MISSED_ADVICE


def _failsafe_before_crash(s: Summary) -> bool:
    """Whether the failsafe commanded before a crash, of which its reason may be the cause."""
    first = s["commanding"]["first_without_mpc"]
    return bool(s["crashed"] and _without_mpc(s) and first["time_s"] < s["crash_time_s"])


def _failsafe_findings(s: Summary) -> Iterator[_Finding]:
    first = s["commanding"]["first_without_mpc"]
    if first and first["reason"]:
        reason = first["reason"]
        advice = next(to_do for part, to_do in _FAILSAFE_ADVICE.items() if part in reason)
        yield f"The failsafe was active: {reason}.", advice


def _controller_findings(s: Summary) -> Iterator[_Finding]:
    """Yield failsafe use, failures, and rejected messages."""
    yield from _failsafe_findings(s)
    for name, (what, to_do) in _COUNTS.items():
        if s[name]:
            yield f"{what}: {s[name]}.", to_do
    for reason, count in s.get("rejected_odometries", {}).items():
        yield f"Odometries that the controller rejects: {count}, {reason}.", ""


def _timing_findings(s: Summary) -> Iterator[_Finding]:
    """Yield late commands, slow odometry and gaps; in lockstep the simulation waits."""
    margins = s["margins"]
    period, control = margins["odom_period_ms"], margins["control_period_ms"]
    if not margins["lockstep"]:
        if s["deadline_misses"]:
            late = f"Commands more than a control period late: {s['deadline_misses']}."
            yield late, _TIME_ADVICE
        if 1e-3 * (s["step_time_us"]["p99"] or 0.0) > _TIGHT_STEP_RATIO * control:
            yield "", _TIME_ADVICE
    if period > SLOW * control:
        yield (
            f"Odometry arrived {1e3 / period:.1f} times a second, control_rate is "
            f"{1e3 / control:g}: this limited the rate of commands.",
            "",
        )
    gaps = s.get("odometry_gaps_s")
    if gaps:
        missing = sum(end - begin for begin, end in gaps)
        begin, end = max(gaps, key=lambda gap: gap[1] - gap[0])
        yield (
            f"Odometry is missing for {missing:.2f} s, longest from {begin:.2f} to {end:.2f} s; "
            "errors are computed from the rest of the flight.",
            "",
        )


def _tracking_findings(s: Summary) -> Iterator[_Finding]:
    """Yield a large position error, body rates at their bounds, and a model mismatch."""
    if (s["position_rmse_m"] or 0.0) > _MAX_RMSE and not s["waypoint_error_m"]:
        yield f"The position error is {s['position_rmse_m']:.2f} m RMSE.", ""
    saturated = s["rate_saturation_fraction"] or 0.0
    if saturated > _MAX_SATURATED_RATIO:
        yield f"{saturated:.0%} of the commands had a body rate at its bound.", _SATURATION_ADVICE
    if _model_is_off(s["estimated"]):
        yield "", _MODEL_ADVICE


def _model_is_off(estimated: Mapping[str, Any]) -> bool:
    """Whether an estimate differs significantly from its configured value."""
    if not estimated:
        return False
    lags = [estimated[name] for name in _LAGS if estimated[name]["value"]]
    return abs(estimated["thrust_scale"]["value"] - 1.0) > _MAX_THRUST_ERROR or any(
        abs(lag["value"] - lag["given"]) > max(_MAX_LAG_ERROR * lag["given"], _MIN_LAG_CHANGE)
        for lag in lags
    )
