# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Verdicts on flights: success, what went wrong, next steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.recordings.evaluation.metrics import Summary, summarise
from quad_mpc_ros.recordings.evaluation.verdict import verdict_on
from quad_mpc_ros.recordings.flight import Flight

FlightMaker = Callable[..., Flight]
LAGS = {"rate_time_constant_ms": 70.0, "yaw_time_constant_ms": 70.0, "thrust_time_constant_ms": 40}


@pytest.fixture
def good(make_flight: FlightMaker, build: SimpleNamespace) -> Summary:
    """Return the summary of a flight at which all is well."""
    flight = make_flight(100)
    ticks = [build.tick(int(stamp), **LAGS) for stamp in flight.stamp_ns]
    return summarise(dataclasses.replace(flight, stats=build.stats(ticks)))


def test_verdict_of_a_good_flight(good: Summary) -> None:
    verdict = verdict_on(good)
    assert verdict.good
    assert verdict.line == "The MPC sent all 100 commands. Nothing went wrong."
    assert verdict.wrong == []
    assert verdict.advice == ["No problems found."]


@pytest.mark.parametrize(
    ("changes", "wrong", "advice"),
    [
        ({"solver_failures": 3}, "without a solution: 3", ""),
        ({"stage_errors": 2}, "inside the controller: 2", "with the bag"),
        ({"deadline_misses": 2}, "period late: 2", "docs/howto/troubleshooting.md"),
        ({"rate_saturation_fraction": 0.2}, "20% of the commands", "Raise R"),
        ({"rejected_inputs": 4}, "unusable: 4", "docs/reference/diagnostics.md"),
        ({"position_rmse_m": 3.4}, "3.40 m RMSE", ""),
        ({"crashed": True, "crash": "away", "crash_time_s": 3.0}, "3.00 s", "rehearse"),
    ],
)
def test_each_failure_has_advice(
    good: Summary, changes: dict[str, Any], wrong: str, advice: str
) -> None:
    verdict = verdict_on(good | changes)
    assert any(wrong in each for each in verdict.wrong)
    assert any(advice in each for each in verdict.advice)
    assert verdict.good == (not {"solver_failures", "stage_errors", "crashed"} & changes.keys())


def test_model_mismatch_advises_identify(good: Summary) -> None:
    seen = good["estimated"]
    lag = {**seen["rate_time_constant_ms"], "value": 110.0}
    verdict = verdict_on(good | {"estimated": {**seen, "rate_time_constant_ms": lag}})
    assert any("identify" in each for each in verdict.advice)


def test_the_estimates_are_those_of_the_later_half(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    flight = make_flight(100)
    scales = np.concatenate((np.full(50, 1.0), np.linspace(0.79, 0.81, 50)))
    ticks = [
        build.tick(int(stamp), thrust_scale=float(scale))
        for stamp, scale in zip(flight.stamp_ns, scales, strict=True)
    ]
    found = summarise(dataclasses.replace(flight, stats=build.stats(ticks)))["estimated"]
    scale = found["thrust_scale"]
    assert scale["value"] == pytest.approx(0.8, abs=0.001)
    assert 0.79 <= scale["low"] < 0.792
    assert 0.808 < scale["high"] <= 0.81


def test_the_fence_and_tilt_that_were_used(make_flight: FlightMaker) -> None:
    flight = make_flight(50)
    fence = dataclasses.replace(flight.mpc.fence, maximum=(1e7, 0.4, 1e7))
    fenced = dataclasses.replace(flight, mpc=dataclasses.replace(flight.mpc, fence=fence))
    assert summarise(fenced)["margins"]["fence_margin_m"] == pytest.approx(0.4)
    assert summarise(flight)["margins"]["fence_margin_m"] is None
    assert summarise(flight)["margins"]["tilt_max_rad"] == 0.0


@pytest.mark.parametrize(
    ("reason", "advice"),
    [
        (
            "the vehicle oscillates: lags or delay may exceed the model's",
            "Raise lags or delay",
        ),
        ("solver: maximum iterations reached", "max_iterations"),
        ("odometry and commands disagree: is the odometry in NED?", "frames, signs and units"),
        ("2 s of thrust do not lift the vehicle", "Check motors, battery, mass"),
        ("odometry is 0.20 s old", "docs/reference/diagnostics.md"),
    ],
)
def test_advice_depends_on_the_reason_of_the_failsafe(
    good: Summary, reason: str, advice: str
) -> None:
    first = {"time_s": 1.0, "source": "hover", "reason": reason}
    commanding = {"ticks": {"mpc": 75, "hover": 25}, "first_without_mpc": first}
    verdict = verdict_on(good | {"commanding": commanding})
    assert not verdict.good
    assert f"First at 1.00 s: {reason}." in verdict.line
    assert any(advice in each for each in verdict.advice)


def test_names_the_contradiction_that_led_to_a_crash(good: Summary) -> None:
    reason = "odometry and commands disagree: is the odometry in NED?"
    first = {"time_s": 1.0, "source": "blind", "reason": reason}
    commanding = {"ticks": {"mpc": 50, "blind": 50}, "first_without_mpc": first}
    crash = {"crashed": True, "crash": "ground", "crash_time_s": 2.0}
    verdict = verdict_on(good | crash | {"commanding": commanding})
    assert reason in verdict.line
    assert "frames, signs and units" in verdict.advice[0]
    later = {"commanding": commanding | {"first_without_mpc": first | {"time_s": 2.5}}}
    assert reason not in verdict_on(good | crash | later).line


@pytest.mark.parametrize("rate", [2, 4, 5, 10, 30])
def test_reports_odometry_slower_than_the_control_rate(good: Summary, rate: int) -> None:
    slow = {"margins": {**good["margins"], "odom_period_ms": 1e3 / rate}}
    assert (
        f"Odometry arrived {rate}.0 times a second, control_rate is 50"
        in verdict_on(good | slow).line
    )


def test_in_lockstep_nothing_is_late(good: Summary) -> None:
    waited = {"deadline_misses": 3, "margins": {**good["margins"], "lockstep": True}}
    assert verdict_on(good | waited).wrong == []


def test_counts_the_odometries_that_were_not_answered(good: Summary) -> None:
    verdict = verdict_on(good | {"commands": 980, "unanswered_odometries": 20})
    assert verdict.line.startswith("The MPC sent 980 of the 1000 commands that were due.")
    assert "Odometries without a command: 20." in verdict.line


HOLD = np.tile([2.0, 0.0, 2.0], (200, 1))  # a goal held for 4 s


@pytest.mark.parametrize(("error", "reached"), [(0.1, True), (0.4, False)])
def test_a_goal_that_is_not_reached_is_no_success(
    make_flight: FlightMaker, build: SimpleNamespace, error: float, reached: bool
) -> None:
    flight = make_flight(200, p_WB=HOLD - [error, 0.0, 0.0], reference=build.reference(HOLD))
    stopped = {"avoidance": "stopped", "avoidance_reason": "no way through"}
    ticks = [build.tick(int(stamp), **stopped) for stamp in flight.stamp_ns]
    verdict = verdict_on(summarise(dataclasses.replace(flight, stats=build.stats(ticks))))
    assert verdict.good is reached
    if not reached:
        missed = "Missed the waypoint (2.00, 0.00, 2.00) m by 0.40 m: no way through."
        assert missed in verdict.line
        assert missed in verdict.wrong


def test_a_flight_too_short_to_reach_a_goal_is_not_judged_by_it(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    flight = make_flight(50, p_WB=HOLD[:50] - 1.0, reference=build.reference(HOLD[:50]))
    assert summarise(flight)["missed"] == []


@pytest.mark.parametrize("passed", [1, 2])
def test_a_missed_gate_is_no_success(
    make_flight: FlightMaker, build: SimpleNamespace, passed: int
) -> None:
    """Along x through gates at 1 m and 3 m, to the end of the course or only half of the way."""
    gates = "{gates: [" + ", ".join(
        f"{{position: [{x}, 0, 2], yaw: 0, width: 1, height: 1}}" for x in (1.0, 3.0)
    )
    course = f"{gates}], start: [0, 0, 2]}}"
    p_WB = np.linspace([0.0, 0.0, 2.0], [2.0 * passed, 0.0, 2.0], 100)
    flight = make_flight(100, p_WB=p_WB, reference=build.reference(p_WB))
    flight = dataclasses.replace(flight, parameters={"reference": {"gates": course}})
    verdict = verdict_on(summarise(flight))
    assert verdict.good is (passed == 2)
    if passed == 1:
        assert verdict.wrong[0] == "Passed 1 of 2 gates, the first missed is gate 2."


def test_advice_after_a_crash_names_the_limit_that_the_reference_exceeds(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    flight = make_flight(100)
    reference = build.reference(flight.p_WB)
    w_WB_B = np.zeros((100, 3))
    w_WB_B[40, 1] = -12.0
    slow = dataclasses.replace(flight.mpc, omega_max=(5.0, 5.0, 3.0))
    fast = dataclasses.replace(reference, w_WB_B=w_WB_B)
    flight = dataclasses.replace(flight, mpc=slow, reference=fast)
    crash = {"crashed": True, "crash": "away", "crash_time_s": 1.0}
    advice = verdict_on(summarise(flight) | crash).advice
    assert "pitch rate of 12 rad/s at 0.80 s, mpc.omega_max is 5 rad/s" in advice[0]
