# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly in wind; the controller estimates the acceleration that its model does not contain.

Drag accelerates the vehicle by mu (wind - v), mu = 0.2 1/s, so a wind of 5 m/s accelerates a
hovering vehicle by 1 m/s^2.
"""

import dataclasses

import numpy as np

from quad_mpc_ros import MpcConfig, ReferenceConfig, SimulatorConfig, simulate

windy = SimulatorConfig(
    wind=(5.0, 0.0, 0.0), initial_position=(0.0, 0.0, 2.0), initial_throttle=0.29
)
hover = ReferenceConfig(trajectory="hover", height=2.0)

error = {}
for estimate in (True, False):
    mpc = dataclasses.replace(MpcConfig(), estimate_disturbance=estimate)
    flight = simulate(mpc, windy, hover, duration=8.0)
    assert flight.reference is not None
    last = flight.time > 6.0
    error[estimate] = float(
        np.linalg.norm(flight.p_WB - flight.reference.p_WB, axis=1)[last].mean()
    )
    learned = flight.stats["disturbance_x"][-1]
    print(
        f"estimate_disturbance={estimate!s:6} error {error[estimate]:.4f} m, "
        f"estimated acceleration {learned:.2f} m/s^2"
    )
    if estimate:
        disturbance_x = float(learned)
