# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Compute one control step without ROS, then simulate ten seconds."""

from quad_mpc_ros import (
    Controller,
    MpcConfig,
    OdometrySample,
    ReferenceWindow,
    simulate,
    summarise,
)

controller = Controller(MpcConfig())
tick = controller.step(OdometrySample.at_rest([0, 0, 1]), ReferenceWindow.hover([1, 0, 1.5]))
assert tick is not None and tick.command is not None
print(f"throttle {tick.command.throttle:.3f}, body rates {tick.command.w_WB_B.round(2)} rad/s")

flight = simulate(duration=10.0)  # the paper's square, from the ground
summary = summarise(flight)
print(f"the square, position RMSE {summary['position_rmse_m']:.3f} m")
