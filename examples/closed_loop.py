# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the square in closed loop with both formulations, and compare the metrics.

The paper's formulation is linearised at the current state and flies an ideal vehicle. The default
formulation is linearised along the plan and flies a vehicle with lags. ``agile`` has the paper's
weights.
``load_config`` reads presets and ROS parameter files.
"""

from quad_mpc_ros import load_config, simulate, summarise

rmse = {}
print(f"{'preset':20}{'RMSE [m]':>10}{'before switch [m]':>20}{'iterations p99':>16}")
for preset in ("paper", "paper_rigid_body", "agile", "default"):
    flight = simulate(*load_config(preset), duration=10.0)
    summary = summarise(flight)
    rmse[preset] = summary["position_rmse_m"]
    before_switch = max(summary["waypoint_error_m"])
    print(
        f"{preset:20}{rmse[preset]:10.3f}{before_switch:20.3f}{summary['iterations']['p99']:16.0f}"
    )
