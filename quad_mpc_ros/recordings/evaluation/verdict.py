"""A summary in plain words: who commanded, margins, what was estimated, what to do next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.control.safety.odometry_gate import SLOW
from quad_mpc_ros.recordings.evaluation.commanding import WITHOUT_MPC
from quad_mpc_ros.recordings.evaluation.crash import crash_text

Summary = Mapping[str, Any]

_MAX_SATURATED_RATIO = 0.05  # of the commands
_MAX_THRUST_ERROR, _MAX_LAG_ERROR = 0.1, 0.25  # of what was given
_MAX_RMSE = 0.5  # m RMSE from a reference that does not jump
_MIN_LAG_CHANGE = 5.0  # ms; a difference below is not worth a flight
_TIGHT_STEP_RATIO = 0.5  # of a control period, at p99

_ADVICE = (
    ("disagree", "Correct frames, signs and units of the odometry (docs/explanation/safety.md)."),
    (
        "do not lift",
        "Check motors, battery, mass and thrust_curve (docs/tutorials/first_flight.md).",
    ),
    ("it oscillates", "Raise lags or delay by half, or fly default (docs/howto/tune.md)."),
    ("solver", "Increase advanced.solver.max_iterations (docs/howto/tune.md)."),
)
_TOO_FAST_ADVICE = (
    "Slow the reference down: reference.time_scaling: auto, or other parameters of it "
    "(docs/howto/references.md)."
)
_MISSED_ADVICE = (
    "Fly longer (--duration), or keep obstacles, fence and limits away from what is asked "
    "(docs/howto/references.md)."
)
_LOOK_UP = "Look up the reason and fix it (docs/reference/diagnostics.md)."

_LAGS = {
    "rate_time_constant_ms": "roll and pitch rates lag by",
    "yaw_time_constant_ms": "yaw rate lags by",
    "thrust_time_constant_ms": "thrust lags by",
}


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A summary in sentences.

    Attributes:
        good: Whether the flight did what was asked, the MPC gave every command, every solve had
            a solution, nothing crashed.
        line: The outcome in one line.
        commanded: Who commanded, and why another than the MPC.
        shares: The share of the ticks that each source commanded.
        margins: How close it came to limits.
        estimated: What the controller estimated of its vehicle.
        wrong: What went wrong.
        advice: Next steps, each with the page that explains it.
    """

    good: bool
    line: str
    commanded: str
    shares: Sequence[str]
    margins: Sequence[str]
    estimated: Sequence[str]
    wrong: Sequence[str]
    advice: Sequence[str]

    @property
    def sections(self) -> dict[str, Sequence[str]]:
        """The sentences below their titles; a title that has none is left out."""
        found = {
            "Who commanded": self.shares,
            "What went wrong": self.wrong,
            "Margins": self.margins,
            "What was estimated": self.estimated,
            "What to do next": self.advice,
        }
        return {title: sentences for title, sentences in found.items() if sentences}


def verdict_on(summary: Summary) -> Verdict:
    """Return what the summary of a flight says (:func:`.metrics.summarise`)."""
    wrong, commanded = _wrong(summary), commanded_text(summary)
    failed = _without_mpc(summary) or summary["solver_failures"] or summary["crashed"]
    failed = failed or summary["stage_errors"] or summary.get("collided") or summary["missed"]
    return Verdict(
        good=bool(summary["commands"] and not failed),
        line=_line(summary, commanded, wrong),
        commanded=commanded,
        shares=_shares(summary),
        margins=_margins(summary),
        estimated=_estimated(summary),
        wrong=wrong,
        advice=_advice(summary),
    )


def commanded_text(summary: Summary) -> str:
    """Return in a sentence or two who commanded, and the first reason where the MPC did not."""
    sources = summary["commanding"]["ticks"]
    first = summary["commanding"]["first_without_mpc"]
    if not summary["commands"]:
        return "No command was given. See the solver status in mpc/stats."
    if not sources:
        return f"{summary['commands']} commands; who gave them was not recorded."
    without = _without_mpc(summary)
    unanswered = summary["unanswered_odometries"]
    if not without and unanswered:
        due = summary["commands"] + unanswered
        return f"The MPC gave {summary['commands']} of the {due} commands that were due."
    if not without:
        return f"The MPC gave every one of the {summary['commands']} commands."
    total = sum(sources.values())
    counts = ", ".join(f"{count} {source}" for source, count in without.items())
    return (
        f"The MPC did not command at {sum(without.values())} of {total} ticks: {counts}. "
        f"First at {first['time_s']:.2f} s: {first['reason']}."
    )


def _line(summary: Summary, commanded: str, wrong: Sequence[str]) -> str:
    if summary["crashed"]:
        return f"CRASHED: {crash_text(summary['crash'], summary['crash_time_s'])}."
    if not summary["commands"] or _without_mpc(summary):
        return commanded
    more = f" {wrong[0]}" if wrong else " Nothing went wrong."
    return f"{commanded}{more}"


def _without_mpc(summary: Summary) -> dict[str, int]:
    """Return the ticks of each source but the MPC, of those that it flew or should have."""
    sources = summary["commanding"]["ticks"]
    return {source: sources[source] for source in WITHOUT_MPC if sources.get(source)}


def _shares(summary: Summary) -> list[str]:
    """Return the share of each source, the MPC's first."""
    ticks = summary["commanding"]["ticks"]
    total = sum(ticks.values())
    ordered = sorted(ticks.items(), key=lambda each: (each[0] != "mpc", -each[1]))
    shares = ", ".join(f"{source} {count / total:.1%}" for source, count in ordered)
    return [f"{shares} of {total} ticks."] if total else []


def _wrong(s: Summary) -> list[str]:
    found: list[str] = []
    if s["crashed"]:
        found.append(f"{_capital(crash_text(s['crash'], s['crash_time_s']))}.")
    elif s.get("collided"):
        found.append("It touched another vehicle.")
    if s.get("collision"):
        x, y, z = s["collision"]["position_m"]
        speed = s["collision"]["speed_m_s"]
        found.append(f"It touched at ({x:.2f}, {y:.2f}, {z:.2f}) m with {speed:.2f} m/s.")
    found += s["missed"]
    if _without_mpc(s):
        found.append(f"The failsafe commanded: {s['commanding']['first_without_mpc']['reason']}.")
    if s["solver_failures"]:
        found.append(f"Solves without a solution: {s['solver_failures']}.")
    if s["stage_errors"]:
        found.append(f"Errors inside the controller: {s['stage_errors']}.")
    if _late(s):
        found.append(f"Commands more than a control period late: {s['deadline_misses']}.")
    period, control = s["margins"]["odom_period_ms"], s["margins"]["control_period_ms"]
    if period > SLOW * control:
        found.append(
            f"Odometry came {1e3 / period:.1f} times a second, control_rate is "
            f"{1e3 / control:g}: commands came no more often."
        )
    if s["unanswered_odometries"]:
        found.append(f"Odometries without a command: {s['unanswered_odometries']}.")
    if s.get("odometry_gaps_s"):
        found.append(_gaps_text(s["odometry_gaps_s"]))
    found += [
        f"Odometries that the controller rejects: {count}, {reason}."
        for reason, count in s.get("rejected_odometries", {}).items()
    ]
    if s["rejected_inputs"]:
        found.append(f"Odometries and references refused as unusable: {s['rejected_inputs']}.")
    if s["estimate_resets"]:
        found.append(f"The estimate did not fit and was reset: {s['estimate_resets']}.")
    if (s["position_rmse_m"] or 0.0) > _MAX_RMSE and not s["waypoint_error_m"]:
        found.append(f"It was {s['position_rmse_m']:.2f} m RMSE away from its reference.")
    if _saturates(s):
        found.append(
            f"{s['rate_saturation_fraction']:.0%} of the commands had a body rate at its bound."
        )
    return found


def _margins(s: Summary) -> list[str]:
    found, used = [], s["margins"]
    period, step, age = used["control_period_ms"], s["step_time_us"], used["odom_age_ms"]
    if step["p99"] is not None:
        found.append(
            f"Time: a control step took {1e-3 * step['p99']:.2f} ms at p99 and "
            f"{1e-3 * step['max']:.2f} ms at most, of a period of {period:g} ms."
        )
    if age["max"] is not None:
        found.append(
            f"Ages: the odometry was {age['p50']:.1f} ms old at p50 and {age['max']:.1f} ms at "
            f"most (odom_timeout {used['odom_timeout_ms']:g} ms), the reference "
            f"{used['reference_age_ms']['max']:.0f} ms at most."
        )
    if s["rate_saturation_fraction"] is not None:
        found.append(
            f"Body rates: {s['rate_saturation_fraction']:.1%} of the commands at a bound."
        )
    tilt, limit = math.degrees(used["tilt_max_rad"]), used["tilt_limit_rad"]
    planned = f"; limits.tilt_max {math.degrees(limit):.0f}°" if limit else ""
    found.append(f"Tilt: {tilt:.0f}° at most{planned}.")
    if s.get("clearance_min_m") is not None:
        found.append(f"Obstacles: {s['clearance_min_m']:.2f} m from its surface at least.")
    fence = used["fence_margin_m"]
    if fence is None:
        found.append("Fence: none was set.")
    elif fence < 0.0:
        found.append(f"Fence: {-fence:.2f} m outside of it.")
    else:
        found.append(f"Fence: {fence:.2f} m from it at least.")
    return found


def _estimated(s: Summary) -> list[str]:
    seen = s["estimated"]
    if not seen or s["crashed"]:  # after a crash it estimates of something that does not fly
        return []
    found = [f"Thrust: {_spread(seen['thrust_scale'])} of the modelled."]
    lags = [
        f"{words} {_spread(seen[name], ' ms')}, given {seen[name]['given']:.0f} ms"
        for name, words in _LAGS.items()
        if seen[name]["value"]
    ]
    found += [f"{_capital('; '.join(lags))}."] if lags else []
    drag = seen["drag"]
    if abs(drag["value"] - drag["given"]) > 1e-3:
        found.append(f"Drag: {_spread(drag, ' 1/s')}, given {drag['given']:.2g} 1/s.")
    pushes = ", ".join(f"{axis} {_spread(seen[f'disturbance_{axis}'])}" for axis in "xyz")
    found.append(f"Disturbance in m/s²: {pushes}.")
    return found


def _advice(s: Summary) -> list[str]:
    found: list[str] = []
    if s["beyond_limits"] and (s["crashed"] or s["missed"]):
        found.append(f"{' '.join(s['beyond_limits'])} {_TOO_FAST_ADVICE}")
    if s["crashed"]:
        return [
            *found,
            "Do not fly a vehicle with this: quad_mpc rehearse says what a configuration bears "
            "(docs/tutorials/first_flight.md).",
        ]
    if s["missed"]:
        found.append(_MISSED_ADVICE)
    reason = (s["commanding"]["first_without_mpc"] or {}).get("reason", "")
    if _without_mpc(s):
        found.append(next((text for start, text in _ADVICE if reason.startswith(start)), _LOOK_UP))
    if _late(s) or _tight(s):
        found.append(
            "Give the MPC more time: fewer mpc.horizon_steps, or advanced.realtime.* "
            "(docs/measurements/performance.md)."
        )
    if s["stage_errors"]:
        found.append("Report the errors in the log, with the bag: they are defects.")
    if s["rejected_inputs"]:
        found.append("Read the log for why messages were refused (docs/reference/diagnostics.md).")
    if _saturates(s):
        found.append(
            "Raise R of the body rates, or omega_max if the rate loop follows more "
            "(docs/howto/tune.md)."
        )
    if _model_is_off(s):
        found.append(
            "The model is off: run quad_mpc identify on this flight, or save-vehicle while it "
            "flies (docs/howto/identify.md)."
        )
    return found or ["No problems found."]


def _model_is_off(s: Summary) -> bool:
    """Whether what was estimated differs from what was given by more than it spreads."""
    seen = s["estimated"]
    if not seen:
        return False
    thrust = abs(seen["thrust_scale"]["value"] - 1.0) > _MAX_THRUST_ERROR
    return thrust or any(
        abs(seen[name]["value"] - seen[name]["given"])
        > max(_MAX_LAG_ERROR * seen[name]["given"], _MIN_LAG_CHANGE)
        for name in _LAGS
        if seen[name]["value"]
    )


def _saturates(s: Summary) -> bool:
    return (s["rate_saturation_fraction"] or 0.0) > _MAX_SATURATED_RATIO


def _late(s: Summary) -> bool:
    """Whether commands came too late; in lockstep the simulation waits for them."""
    return bool(s["deadline_misses"] and not s["margins"]["lockstep"])


def _tight(s: Summary) -> bool:
    step, period = s["step_time_us"]["p99"] or 0.0, s["margins"]["control_period_ms"]
    return bool(1e-3 * step > _TIGHT_STEP_RATIO * period and not s["margins"]["lockstep"])


def _spread(estimate: Mapping[str, float], unit: str = "") -> str:
    """Return a value and where the middle 90 % of the ticks lay."""
    style = "{:z.0f}" if unit == " ms" else "{:z.2f}"  # z: no -0.00
    value, low, high = (style.format(estimate[name]) for name in ("value", "low", "high"))
    return f"{value}{unit} ({low} to {high})"


def _gaps_text(gaps: Sequence[Sequence[float]]) -> str:
    missing = sum(end - begin for begin, end in gaps)
    begin, end = max(gaps, key=lambda gap: gap[1] - gap[0])
    return (
        f"Odometry is missing for {missing:.2f} s, longest from {begin:.2f} to {end:.2f} s, and "
        "the errors are those of the rest."
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
