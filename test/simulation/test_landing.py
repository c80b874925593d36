# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Landing of the simulated vehicle with controller and live reference."""

from __future__ import annotations

import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory, joined_trajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.sensors import OdometryStream

LAGS = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03}
LAND_NS = SIMULATION_START_NS + 500_000_000


@pytest.mark.parametrize("error", [-0.3, 0.3])
def test_lands_on_unknown_ground_with_an_error_of_the_height(error: float) -> None:
    """The controller begins in the air, and notices the contact within 0.16 s."""
    config = ReferenceConfig(trajectory="hover", height=1.0)
    live = LiveReference(
        config, configured_trajectory(config), joined=lambda: joined_trajectory(config)
    )
    simulator = SimulatorConfig(
        **LAGS,
        duration=8.5,
        position_bias=(0.0, 0.0, error),
        initial_position=(0.0, 0.0, 1.0 - error),
    )
    plant, controller = make_plant(simulator), warmed_up(MpcConfig.build(LAGS))
    stream = OdometryStream(plant, simulator, start_stamp_ns=SIMULATION_START_NS)
    heights, throttles, states = [], [], []
    while (sent := stream.step()) is not None:
        now_ns = sent.odometry.stamp_ns
        live.observe(sent.odometry)
        if now_ns == LAND_NS:
            assert live.land(now_ns).accepted
        window = live.window(now_ns)
        assert window is not None
        controller.receive_reference(window, now_ns=now_ns)
        tick = controller.receive_odometry(sent.odometry, now_ns=now_ns)
        assert tick is not None
        assert tick.command is not None
        live.set_ground_state(controller.ground_state)
        plant.apply(tick.command)
        heights.append(sent.truth.p_WB[2])
        throttles.append(tick.command.throttle)
        states.append(tick.stats.ground)
    assert live.mode(SIMULATION_START_NS + 8_500_000_000) == "ground"
    touchdown = heights.index(0.0)
    assert not any(heights[touchdown:])
    touching = states.index("touching_down")
    assert 0 <= touching - touchdown <= 8
    assert states.index("on_ground") > touching
    assert "flying" not in states[touching:]
    assert max(throttles[-20:]) < 0.02
    speed = (heights[touchdown - 3] - heights[touchdown - 1]) * 25.0
    assert speed == pytest.approx(0.3, abs=0.1)
