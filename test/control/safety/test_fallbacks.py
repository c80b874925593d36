# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controllers without a solver, flown on a true rigid body."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from fixtures.motions import unit
from fixtures.plant_motion import integrate
from fixtures.presets import ideal
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input, State, state_from_odometry
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.safety.fallbacks import (
    BlindFallback,
    HoverFallback,
)
from quad_mpc_ros.simulation.closed_loop import fly

PERIOD = 0.02


def flown(x: State, u: Input, vehicle: Vehicle, duration: float = PERIOD) -> State:
    for _ in range(2):
        x = integrate(x, u, vehicle, duration=duration / 2)
    return x


def assert_inside_bounds(u: Input, config: MpcConfig) -> None:
    assert config.throttle_min <= u.throttle <= config.throttle_max
    assert np.isfinite(u.w_WB_B).all()
    assert (np.abs(u.w_WB_B) <= config.omega_max).all()


UPSIDE_DOWN = Rotation.from_euler("x", 180, degrees=True).as_matrix()


@pytest.mark.parametrize("seed", [1, 2, 3, None])
def test_hover_brakes_from_ten_metres_per_second_in_any_attitude_and_holds(
    seed: int | None, paper_config: MpcConfig
) -> None:
    rng = np.random.default_rng(seed or 0)
    attitude = Rotation.from_quat(rng.normal(size=4)).as_matrix() if seed else UPSIDE_DOWN
    start = np.array([3.0, -4.0, 200.0])
    x = State(p_WB=start, v_WB_B=10.0 * unit(rng), R_WB=attitude)
    hover, vehicle = HoverFallback(paper_config), Vehicle()
    furthest = 0.0
    for _ in range(round(10.0 / PERIOD)):
        u = hover.command(x)
        assert_inside_bounds(u, paper_config)
        x = flown(x, u, vehicle)
        furthest = max(furthest, float(np.linalg.norm(x.p_WB - start)))
    assert furthest < 20.0
    assert np.linalg.norm(x.v_WB_W) < 0.05
    assert np.linalg.norm(x.p_WB - start) < 0.1
    assert x.R_WB[2, 2] > math.cos(math.radians(1.0))


def test_hover_at_rest_commands_the_weight(paper_config: MpcConfig) -> None:
    x = State(
        p_WB=np.array([1.0, 2.0, 3.0]),
        v_WB_B=np.zeros(3),
        R_WB=Rotation.from_euler("z", 2.0).as_matrix(),
    )
    u = HoverFallback(paper_config).command(x)
    assert u.throttle == pytest.approx(Vehicle().hover_throttle, abs=1e-12)
    assert_allclose(u.w_WB_B, np.zeros(3), atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1e6), st.floats(0.0, 1e6))
def test_fallback_commands_are_finite_and_inside_the_bounds(
    paper_config: MpcConfig, seed: int, distance: float, speed: float
) -> None:
    rng = np.random.default_rng(seed)
    config = dataclasses.replace(
        paper_config, throttle_min=0.1, throttle_max=0.7, omega_max=(3.0, 2.0, 1.0)
    )
    x = State(
        p_WB=np.zeros(3),
        v_WB_B=speed * unit(rng),
        R_WB=Rotation.from_quat(rng.normal(size=4)).as_matrix(),
    )
    hover = HoverFallback(config)
    assert_inside_bounds(hover.command(x), config)
    moved = dataclasses.replace(x, p_WB=distance * unit(rng))
    assert_inside_bounds(hover.command(moved), config)
    assert_inside_bounds(BlindFallback(config).command(x.R_WB, elapsed=speed), config)


@pytest.mark.parametrize("tilt", [0.0, 45.0, 90.0, 170.0, 180.0])
def test_blind_source_levels_and_descends(tilt: float, paper_config: MpcConfig) -> None:
    vehicle, blind = Vehicle(), BlindFallback(paper_config)
    R_estimated = Rotation.from_euler("zx", [50.0, tilt], degrees=True).as_matrix()
    x = State(p_WB=np.array([0.0, 0.0, 50.0]), v_WB_B=np.zeros(3), R_WB=R_estimated)
    throttles = []
    for tick in range(round(paper_config.blind_time / PERIOD) + 1):
        u = blind.command(R_estimated, elapsed=tick * PERIOD)
        throttles.append(u.throttle)
        blind.dead_reckon(R_estimated, u.w_WB_B, duration=PERIOD)
        x = flown(x, u, vehicle)
    assert x.R_WB[2, 2] > math.cos(math.radians(1.0))
    assert x.v_WB_W[2] < -0.3
    assert throttles[0] == pytest.approx(vehicle.hover_throttle)
    assert (np.diff(throttles) < 0.0).all()
    # Sinking, not falling.
    assert vehicle.thrust(throttles[-1]) > 0.5 * vehicle.mass * vehicle.gravity


@pytest.mark.parametrize("seed", range(4))
def test_hover_stabilises_vehicles_with_unknown_lags_delay_and_thrust(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lags = rng.uniform(0.02, 0.08, size=2)
    simulator = ideal(
        duration=12.0,
        rate_time_constant=lags[0],
        thrust_time_constant=lags[1],
        command_delay=rng.uniform(0.005, 0.08),
        thrust_scale=rng.uniform(0.7, 1.3),
        wind=tuple(rng.uniform(-4.0, 4.0, size=3)),
        initial_position=(0.3, -0.3, 2.3),
        initial_throttle=0.3,
    )
    hover, hold = HoverFallback(MpcConfig()), np.array([0.0, 0.0, 2.0])

    def law(odometry: OdometrySample, _: ReferenceWindow) -> CommandSample:
        u = hover.command(state_from_odometry(odometry), p_hold=hold, duration=PERIOD)
        return CommandSample(stamp_ns=odometry.stamp_ns, throttle=u.throttle, w_WB_B=u.w_WB_B)

    steps = list(fly(simulator=simulator, controller=law))
    tilts = [math.acos(step.truth.up) for step in steps]
    assert max(tilts) < math.radians(15.0)
    assert np.linalg.norm(steps[-1].truth.p_WB - hold) < 0.1
