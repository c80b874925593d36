"""The default settles although commands take 80 ms longer than it models."""

from __future__ import annotations

import math

import pytest
from fixtures.presets import ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly

MPC = MpcConfig()
MORE = 0.08  # s


@pytest.mark.parametrize("start", [(0.4, 0.4, 2.4), (-0.4, 0.1, 1.6), (0.0, -0.3, 2.0)])
def test_hover_settles(start: tuple[float, float, float]) -> None:
    simulator = ideal(
        duration=10.0,
        initial_position=start,
        initial_throttle=0.29,
        rate_time_constant=MPC.rate_time_constant,
        thrust_time_constant=MPC.thrust_time_constant,
        command_delay=MPC.input_delay + MORE,
    )
    hover = ReferenceConfig(trajectory="hover", height=2.0)
    steps = list(fly(simulator=simulator, reference=hover, controller=Controller(MPC)))
    assert {step.tick.decision.source for step in steps if step.tick} == {Source.MPC}
    late = steps[len(steps) // 2 :]
    assert min(step.truth.up for step in late) > math.cos(math.radians(10.0))
