# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Each controller of this package hovers, and flies the square and a lemniscate."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros import (
    CommandSample,
    MpcConfig,
    OdometrySample,
    ReferenceConfig,
    ReferenceWindow,
    SimulatorConfig,
    simulate,
    so3,
    summarise,
)
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.controllers.lqr import gain
from quad_mpc_ros.extras.controllers.px4 import Px4Controller
from quad_mpc_ros.extras.controllers.registry import configured_law
from quad_mpc_ros.simulation.closed_loop import fly

NAMES = ("geometric", "px4", "lqr")
LAGGED = SimulatorConfig(rate_time_constant=0.05, thrust_time_constant=0.04, command_delay=0.02)


@pytest.mark.parametrize("name", NAMES)
def test_flies_a_hover_a_square_and_a_lemniscate_with_lags(name: str) -> None:
    config = MpcConfig(controller=name)
    hover = simulate(config, LAGGED, ReferenceConfig(trajectory="hover"))
    assert abs(hover.p_WB[-50:, 2] - 2.0).max() < 0.05
    square = simulate(config, LAGGED, ReferenceConfig())
    assert max(summarise(square)["waypoint_error_m"]) < 0.2
    lemniscate = ReferenceConfig(trajectory="lemniscate")
    figures = summarise(simulate(config, LAGGED, lemniscate, on_reference=True))
    assert figures["position_rmse_m"] < 0.5
    for flight in (hover, square):
        figures = summarise(flight)
        assert figures["fallbacks"] == 0 and not figures["crashed"]
        assert figures["step_time_us"]["p50"] > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_on_the_reference_the_command_is_hover(name: str) -> None:
    law = configured_law(MpcConfig(controller=name))
    assert law is not None
    law.reset()
    odometry = OdometrySample.at_rest([1.0, 2.0, 3.0], yaw=0.7)
    command = law.step(odometry, ReferenceWindow.hover([1.0, 2.0, 3.0], yaw=0.7))
    assert_allclose(command.throttle, MpcConfig().vehicle().hover_throttle, atol=1e-9)
    assert_allclose(command.w_WB_B, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_commands_point_towards_the_reference(name: str) -> None:
    """East of the vehicle: pitch nose down, about +y in FLU; higher: more throttle; yaw turns."""
    law = configured_law(MpcConfig(controller=name))
    assert law is not None
    hover = MpcConfig().vehicle().hover_throttle
    odometry = OdometrySample.at_rest([0.0, 0.0, 1.0])
    east = law.step(odometry, ReferenceWindow.hover([0.5, 0.0, 1.0]))
    north = law.step(odometry, ReferenceWindow.hover([0.0, 0.5, 1.0]))
    higher = law.step(odometry, ReferenceWindow.hover([0.0, 0.0, 1.5]))
    turned = law.step(odometry, ReferenceWindow.hover([0.0, 0.0, 1.0], yaw=0.3))
    assert east.w_WB_B[1] > 0.1 and abs(east.w_WB_B[0]) < 1e-9
    assert north.w_WB_B[0] < -0.1 and abs(north.w_WB_B[1]) < 1e-9
    assert higher.throttle > hover + 0.01
    assert turned.w_WB_B[2] > 0.1
    # Heading north, east is on the right: roll right, about +x.
    odometry = OdometrySample.at_rest([0.0, 0.0, 1.0], yaw=math.pi / 2)
    east = law.step(odometry, ReferenceWindow.hover([0.5, 0.0, 1.0], yaw=math.pi / 2))
    assert east.w_WB_B[0] > 0.1 and abs(east.w_WB_B[1]) < 1e-6


def test_rest_off_the_reference_is_no_contradiction_unless_the_controller_commands_a_turn() -> (
    None
):
    """Without integral the geometric controller rests below the reference if thrust is missing.
    If the odometry freezes beside the reference, it turns towards it without end."""
    config = MpcConfig(controller="geometric", lockstep=True)
    weak = SimulatorConfig(thrust_scale=0.75)
    flight = simulate(config, weak, ReferenceConfig(trajectory="hover"), duration=12.0)
    assert set(flight.stats["source"]) == {"mpc"}
    assert 0.15 < 2.0 - flight.p_WB[-1, 2] < 0.3
    controller, reasons = warmed_up(config), set()

    def frozen(odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        if odometry.stamp_ns > 6_000_000_000:
            beside = OdometrySample.at_rest([0.15, 0.0, 2.0], stamp_ns=odometry.stamp_ns)
            odometry = beside
        tick = controller.step(odometry, window)
        assert tick is not None
        reasons.add(tick.decision.reason)
        return tick.command

    simulator = SimulatorConfig(duration=10.0)
    hover = ReferenceConfig(trajectory="hover")
    assert len(list(fly(simulator=simulator, reference=hover, controller=frozen))) == 500
    assert any("is the odometry frozen?" in reason for reason in reasons)


def test_px4_limits_tilt_and_rates_and_integrates_a_constant_error() -> None:
    law = Px4Controller(MpcConfig())
    far = ReferenceWindow.hover([100.0, 0.0, 1.0])
    tilted, rates = 0.0, []
    for k in range(100):
        # A vehicle at rest that would be tilted as commanded if it moved.
        odometry = OdometrySample(
            stamp_ns=k * 20_000_000,
            p_WB=np.array([0.0, 0.0, 1.0]),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(so3.exp([0.0, tilted, 0.0])),
            v_WB_B=np.zeros(3),
            w_WB_B=np.zeros(3),
        )
        rates.append(law.step(odometry, far).w_WB_B)
        tilted += 0.02 * rates[-1][1]
    assert_allclose(np.max(rates, axis=0)[1], math.radians(220.0))
    assert tilted == pytest.approx(math.radians(45.0), abs=0.01)
    law.reset()
    level = OdometrySample.at_rest([0.0, 0.0, 1.0])
    first = law.step(level, ReferenceWindow.hover([0.0, 0.0, 1.1])).throttle
    for k in range(1, 50):
        level = OdometrySample.at_rest([0.0, 0.0, 1.0], stamp_ns=k * 20_000_000)
        last = law.step(level, ReferenceWindow.hover([0.0, 0.0, 1.1])).throttle
    assert last > first


def test_lqr_gain_stabilises_the_model_and_scales_with_the_weights() -> None:
    config = MpcConfig()
    K = gain(config)
    assert K.shape == (4, 12)
    assert_allclose(K[1, 1], -K[2, 0], rtol=1e-9)  # roll and pitch alike, with opposite signs
    stiffer = gain(config.updated({"Q": (40.0,) * 3 + config.Q[3:]}))
    assert stiffer[2, 0] > K[2, 0] > 0.0
