# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Flights with an accelerometer in gusts, and with a missing one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig

SETTLED_NS = 4_000_000_000
GUSTS = {"wind": (2.0, -1.0, 0.0), "gust_intensity": 1.0, "drag": 0.4}
NOISES: dict[str, dict[str, Any]] = {
    "white": {"velocity_noise": 0.3},
    "correlated": {"velocity_noise": 0.02, "velocity_drift": 0.3},
}


def flown(*, noise: float, imu_rate: float = 200.0, **simulator: Any) -> list[LoopStep]:
    """Return a hover of 14 s, with an accelerometer that is assumed to have a noise."""
    return list(
        fly(
            mpc=MpcConfig(accelerometer_noise=noise),
            simulator=SimulatorConfig(
                duration=14.0,
                position_noise=0.003,
                attitude_noise=0.003,
                rate_noise=0.02,
                imu_rate=imu_rate,
                imu_noise=0.2,
                **simulator,
            ),
            reference=ReferenceConfig(trajectory="hover", height=2.0),
            on_reference=True,
        )
    )


def rmse(steps: list[LoopStep]) -> float:
    assert {step.tick.decision.source.name for step in steps if step.tick} == {"MPC"}
    errors = [
        step.truth.p_WB - step.window.p_WB[0]
        for step in steps
        if step.truth.stamp_ns - steps[0].truth.stamp_ns > SETTLED_NS
    ]
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


def commands(steps: list[LoopStep]) -> list[bytes]:
    return [
        np.array([step.command.throttle, *step.command.w_WB_B]).tobytes()
        for step in steps
        if step.command is not None
    ]


@pytest.mark.parametrize("kind", NOISES)
def test_accelerometer_reduces_gust_displacement(kind: str) -> None:
    """With white and with correlated noise of the velocity, and a usual bias."""
    bias = (0.2, -0.2, 0.2)
    without_imu = rmse(flown(noise=0.0, **GUSTS, **NOISES[kind]))
    with_imu = flown(noise=0.5, imu_bias=bias, **GUSTS, **NOISES[kind])
    assert rmse(with_imu) < 0.75 * without_imu
    uses = [step.tick.stats.accelerometer for step in with_imu[200:] if step.tick]
    assert uses.count("used") > 0.95 * len(uses)


def test_a_missing_accelerometer_changes_no_command() -> None:
    without_imu = flown(noise=0.0, imu_rate=0.0, velocity_noise=0.05)
    silent = flown(noise=0.5, imu_rate=0.0, velocity_noise=0.05)
    assert commands(silent) == commands(without_imu)
    stats = [step.tick.stats for step in silent if step.tick]
    begins = [each.accelerometer for each in stats].index("missing")  # as commands act
    assert {each.accelerometer for each in stats[:begins]} == {"paused"}
    assert {each.accelerometer for each in stats[begins:]} == {"missing"}
    assert {each.imu_stamp_ns for each in stats} == {0}
