# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The rate loop of second order against an integrator of another kind and against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.internal_plant import InternalPlant

HOVER = Vehicle().hover_throttle
COMMAND = np.array([3.0, -2.0, 1.0])


def plant(**changes: Any) -> InternalPlant:
    start = {"initial_position": (0.0, 0.0, 50.0), "initial_throttle": HOVER}
    return InternalPlant(ideal({**start, "integration_step": 0.001, **changes}))


def flown(vehicle: InternalPlant, seconds: float, throttle: float = HOVER) -> None:
    command = CommandSample(stamp_ns=vehicle.time_ns, throttle=throttle, w_WB_B=COMMAND)
    vehicle.apply(command)
    vehicle.advance_to(vehicle.time_ns + round(1e9 * seconds))


@pytest.mark.parametrize("most", [0.0, 60.0])
def test_rotation_agrees_with_an_independent_integrator(most: float) -> None:
    lags, torque = np.array([0.04, 0.05, 0.2]), np.array([0.1, 0.03, 0.0])
    vehicle = plant(
        rate_time_constant=tuple(lags),
        torque_time_constant=tuple(torque),
        angular_acceleration_max=most,
    )

    def derivative(_: float, y: Array) -> Array:
        w, alpha = y[4:7], y[7:10]
        wanted = (COMMAND - w) / lags
        if most:
            wanted = np.clip(wanted, -most, most)
        xyz, real = y[:3], y[3]
        turning = 0.5 * np.append(real * w + np.cross(xyz, w), -xyz @ w)
        slope = np.where(torque > 0.0, (wanted - alpha) / np.where(torque > 0.0, torque, 1.0), 0.0)
        return np.concatenate([turning, np.where(torque > 0.0, alpha, wanted), slope])

    seconds = 0.4
    flown(vehicle, seconds)
    begin = np.concatenate([[0.0, 0.0, 0.0, 1.0], np.zeros(6)])
    end = solve_ivp(
        derivative, (0.0, seconds), begin, method="DOP853", rtol=1e-10, atol=1e-12, max_step=1e-3
    ).y[:, -1]
    assert_allclose(vehicle._x["w_WB_B"], end[4:7], atol=2e-4 if most else 1e-6)
    error = Rotation.from_quat(end[:4]).inv() * Rotation.from_matrix(vehicle.state.R_WB)
    assert error.magnitude() < (1e-4 if most else 1e-6)


def test_throttle_decreases_with_a_lag_of_its_own() -> None:
    vehicle = plant(thrust_time_constant=0.03, thrust_time_constant_down=0.1)
    flown(vehicle, 0.06, throttle=1.0)
    after = 1.0 + math.exp(-2.0) * (HOVER - 1.0)
    assert vehicle._x["throttle"] == pytest.approx(after)
    flown(vehicle, 0.05, throttle=0.0)
    assert vehicle._x["throttle"] == pytest.approx(after * math.exp(-0.5))
