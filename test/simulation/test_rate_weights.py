# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The factor on the weights of the rates: small for a known rate loop, else large."""

from __future__ import annotations

import numpy as np
from fixtures.presets import ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly

NOISE = {
    "position_noise": 0.003,
    "attitude_noise": 0.003,
    "velocity_noise": 0.02,
    "rate_noise": 0.02,
}


def factors(uncertainty: float, *, lag: float) -> tuple[Array, float]:
    """Fly a lemniscate; return the factor at each tick of 12 s, and the late mean error [m].

    ``uncertainty`` is configured, ``lag`` is that of the vehicle's rate loop [s].
    """
    mpc = MpcConfig(latency_uncertainty=uncertainty)
    steps = fly(
        mpc=mpc,
        simulator=ideal(
            duration=12.0,
            wind=(2.0, 0.0, 0.0),
            gust_intensity=0.5,
            rate_time_constant=lag,
            torque_time_constant=mpc.torque_time_constant,
            thrust_time_constant=mpc.thrust_time_constant,
            command_delay=mpc.input_delay,
            **NOISE,
        ),
        reference=ReferenceConfig(trajectory="lemniscate", angular_frequency=1.2),
        on_reference=True,
    )
    found, errors = [], []
    for step in steps:
        if step.tick is not None:
            found.append(step.tick.stats.rate_weight_scale)
            errors.append(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]))
    return np.array(found), float(np.mean(errors[300:]))


def test_weights_of_an_unidentified_vehicle_fall_in_flight() -> None:
    found, _error = factors(0.15, lag=0.05)
    assert found[0] == 1.0
    assert found[-1] < 0.4


def test_identified_vehicle_is_stiff_from_the_start() -> None:
    found, error = factors(0.003, lag=0.07)
    assert found[0] == 0.02
    assert np.median(found) < 0.05
    _, unidentified = factors(0.15, lag=0.07)
    assert error < unidentified


def test_weights_rise_if_the_vehicle_is_not_the_identified_one() -> None:
    found, _error = factors(0.003, lag=0.3)
    assert found[:50].max() > 1.0
    assert found[50:].min() > 0.1
