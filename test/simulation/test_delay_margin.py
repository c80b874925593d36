# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The default settles with 80 ms more delay of the commands than modelled."""

from __future__ import annotations

import math

from fixtures.presets import ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly

MPC = MpcConfig()
MORE = 0.08  # s


def test_hover_settles() -> None:
    simulator = ideal(
        duration=10.0,
        initial_position=(0.4, 0.4, 2.4),
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
