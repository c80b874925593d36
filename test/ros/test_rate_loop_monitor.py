# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which vehicles have a rate loop that the MPC's node reports, with which numbers."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace
from typing import cast

import pytest
from fixtures.recorded_flights import tick
from fixtures.ros_context import initialised

from quad_mpc_ros import load_config, simulate
from quad_mpc_ros.control.safety.ladder import Decision, Source
from quad_mpc_ros.control.tick import Tick, TickStats
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.rate_loop_monitor import RateLoopMonitor


def reported(tau: float, torque: float) -> list[str]:
    """Fly a lemniscate at 1.5 rad/s with the default lags, and return what is reported."""
    flown = simulate(
        *load_config(
            assignments=[
                "reference.trajectory=lemniscate",
                "reference.angular_frequency=1.5",
                f"simulator.rate_time_constant={tau}",
                f"simulator.torque_time_constant={torque}",
            ]
        ),
        duration=9.0,
    )
    monitor, found = RateLoopMonitor(), []
    names = [field.name for field in dataclasses.fields(TickStats)]
    for values in zip(*(flown.stats[name] for name in names), strict=True):
        found.append(monitor.check(TickStats(**dict(zip(names, values, strict=True)))))
    return [fault for fault in found if fault is not None]


@pytest.mark.parametrize(("tau", "torque"), [(0.04, 0.1), (0.04, 0.2), (0.3, 0.15)])
def test_reports_loops_that_ring_or_are_slow(tau: float, torque: float) -> None:
    last = reported(tau, torque)[-1]
    numbers = re.fullmatch(r"rate loop of roll and pitch: (.*) Hz, damping (.*?); .*", last)
    assert numbers is not None
    frequency, damping = map(float, numbers.groups())
    assert frequency == pytest.approx(1.0 / (6.283 * (tau * torque) ** 0.5), abs=0.15)
    assert damping == pytest.approx(0.5 * (tau / torque) ** 0.5, abs=0.05)
    assert ("lower P" in last) == (torque > tau)


@pytest.mark.parametrize(("tau", "torque"), [(0.0, 0.0), (0.07, 0.02), (0.04, 0.03)])
def test_reports_no_loop_that_is_tuned(tau: float, torque: float) -> None:
    assert reported(tau, torque) == []


def test_health_reports_a_confirmed_fault_without_side_effects() -> None:
    with initialised(["--ros-args", "-p", "autostart:=false", "--log-level", "FATAL"]):
        node = MpcNode()
        node.trigger_configure()
        for seconds in range(7):
            ringing = {"rate_time_constant_ms": 40.0, "torque_time_constant_ms": 100.0}
            stats = tick(seconds * 10**9, **ringing)
            node._tick = cast(Tick, SimpleNamespace(stats=stats, decision=Decision(Source.MPC)))
            before = [node.report().text for _ in range(2)]
            node._check_faults()
            texts = [*before, node.report().text]
            assert ["rate loop" in text for text in texts] == [seconds > 5] * 2 + [seconds > 4]
        node.destroy_node()
