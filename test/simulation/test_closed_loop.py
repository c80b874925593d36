# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The loop without ROS: repeatable, on time, and flying."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import (
    LoopStep,
    fly,
)
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.sensors import odometry_stamps


@pytest.fixture(scope="module")
def mpc() -> MpcConfig:
    return agile(formulation="paper", terminal_weight=1.0, horizon_steps=10, horizon_step=0.05)


@pytest.fixture(scope="module")
def flight(mpc: MpcConfig) -> list[LoopStep]:
    """Return ten seconds of the paper's controller on a true rigid body."""
    return list(fly(mpc=mpc, simulator=rigid_body(10.0), reference=ReferenceConfig()))


def rigid_body(duration: float, odom_rate: float = 50.0) -> SimulatorConfig:
    return ideal(dynamics="rigid_body", duration=duration, odom_rate=odom_rate)


def commands(flight: list[LoopStep]) -> Array:
    return np.array(
        [
            [step.tick.command.throttle, *step.tick.command.w_WB_B]
            for step in flight
            if step.tick is not None and step.tick.command is not None
        ]
    )


def test_the_papers_controller_flies_a_true_rigid_body_late(flight: list[LoopStep]) -> None:
    errors = [np.linalg.norm(step.window.p_WB[0] - step.odometry.p_WB) for step in flight]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.811, abs=0.01)
    assert max(errors[99::100]) < 0.15


def test_lockstep_gives_the_same_bytes(flight: list[LoopStep], mpc: MpcConfig) -> None:
    lockstep = fly(
        mpc=dataclasses.replace(mpc, lockstep=True),
        simulator=dataclasses.replace(rigid_body(10.0), lockstep=True),
        reference=ReferenceConfig(lockstep=True),
    )
    assert commands(list(lockstep)).tobytes() == commands(flight).tobytes()


EFFECTS = ideal(
    duration=3.0,
    rate_time_constant=0.02,
    thrust_time_constant=0.02,
    command_delay=0.0071,
    wind=(1.0, 0.0, 0.0),
    gust_intensity=0.5,
    position_noise=0.002,
    attitude_noise=0.002,
    velocity_noise=0.01,
    rate_noise=0.01,
    odom_delay=0.0043,
    odom_dropout=0.05,
    odom_jitter=0.001,
    seed=11,
)


def test_two_flights_with_every_effect_give_the_same_bytes(mpc: MpcConfig) -> None:
    one, other = (
        list(fly(mpc=mpc, simulator=EFFECTS, reference=ReferenceConfig())) for _ in range(2)
    )
    assert 120 < len(one) < 150
    assert commands(one).tobytes() == commands(other).tobytes()
    reseeded = dataclasses.replace(EFFECTS, seed=12)
    third = list(fly(mpc=mpc, simulator=reseeded, reference=ReferenceConfig()))
    assert commands(third).tobytes() != commands(one).tobytes()


def test_a_step_has_the_truth_and_the_time_of_publication(mpc: MpcConfig) -> None:
    steps = list(fly(mpc=mpc, simulator=EFFECTS, reference=ReferenceConfig()))
    errors = np.array([step.odometry.p_WB - step.truth.p_WB for step in steps])
    assert errors.std() == pytest.approx(0.002, rel=0.15)
    for step in steps:
        assert step.truth.stamp_ns == step.odometry.stamp_ns == step.window.stamp_ns
        assert step.sent_ns == step.odometry.stamp_ns + 4_300_000


def test_stamps_do_not_accumulate_rounding() -> None:
    rate = 333.0
    stamps = list(odometry_stamps(rigid_body(100.0, rate)))
    assert len(stamps) == 100 * rate
    assert stamps[0] == 0
    for number, stamp in enumerate(stamps):
        assert abs(stamp - number * 1e9 / rate) <= 0.5
