# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulated vehicle: time, command, ground."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.internal_plant import InternalPlant

SECOND = 1_000_000_000
HOVER = Vehicle().hover_throttle
HEADING_07 = (0.0, 0.0, math.sin(0.35), math.cos(0.35))
HEADING_NORTH = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


def command(throttle: float, rates: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> CommandSample:
    return CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(rates))


def plant(**changes: Any) -> InternalPlant:
    return InternalPlant(ideal({"initial_position": (0.0, 0.0, 10.0), **changes}))


def assert_same_state(one: InternalPlant, other: InternalPlant, *, atol: float) -> None:
    for name in ("p_WB", "v_WB_B", "R_WB"):
        assert_allclose(
            getattr(one.state, name), getattr(other.state, name), rtol=0.0, atol=atol, err_msg=name
        )


@pytest.mark.parametrize("throttle", [0.0, 0.1, HOVER - 1e-6])
def test_stays_on_the_ground_without_enough_thrust(throttle: float) -> None:
    body = plant(
        initial_position=(1.0, 2.0, 0.0), initial_attitude=HEADING_07, wind=(10.0, 0.0, 0.0)
    )
    body.apply(command(throttle, (2.0, -3.0, 0.0)))
    body.advance_to(3 * SECOND)
    assert_array_equal(body.state.p_WB, [1.0, 2.0, 0.0])
    assert_array_equal(body.state.v_WB_B, np.zeros(3))
    heading = Rotation.from_euler("z", 0.7).as_matrix()
    assert_allclose(body.state.R_WB, heading, atol=1e-2)
    assert_allclose(body.state.R_WB[2], [0.0, 0.0, 1.0], atol=0.0)
    assert_array_equal(body.odometry(0).w_WB_B, np.zeros(3))


@settings(deadline=None, max_examples=20)
@given(
    st.floats(0.0, HOVER),
    st.tuples(*[st.floats(-10.0, 10.0)] * 3),
    st.floats(0.0, 3.0),
)
def test_never_falls_through_the_ground(
    throttle: float, rates: tuple[float, float, float], height: float
) -> None:
    body = plant(initial_position=(0.0, 0.0, height))
    body.apply(command(throttle, rates))
    for tick in range(1, 60):
        body.advance_to(tick * 50_000_000)
        assert body.state.p_WB[2] >= 0.0
        assert np.isfinite(body.state.p_WB).all()


def test_lands_level_after_a_fall_and_takes_off_again() -> None:
    body = plant(initial_position=(0.0, 0.0, 1.0))
    body.apply(command(0.0, (1.0, 0.5, 0.0)))
    body.advance_to(SECOND)
    assert_array_equal(body.state.v_WB_B, np.zeros(3))
    assert body.state.p_WB[2] == 0.0
    assert_allclose(body.state.R_WB[:, 2], [0.0, 0.0, 1.0], atol=1e-15)
    body.apply(command(0.5))
    body.advance_to(2 * SECOND)
    assert body.state.p_WB[2] > 1.0
    assert body.state.v_WB_W[2] > 1.0


def test_starts_in_the_configured_motion() -> None:
    q = tuple(Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_quat())
    body = plant(
        initial_velocity=(1.0, 2.0, -3.0),
        initial_attitude=q,
        initial_body_rates=(0.1, -0.2, 0.3),
        initial_throttle=0.4,
    )
    assert_allclose(body.state.v_WB_W, [1.0, 2.0, -3.0], atol=1e-14)
    assert_allclose(body.state.R_WB, Rotation.from_quat(q).as_matrix(), atol=1e-14)
    assert_array_equal(body.odometry(0).w_WB_B, [0.1, -0.2, 0.3])
    started = plant(initial_velocity=(1.0, 2.0, -3.0), initial_attitude=q)
    started.apply(command(0.4, (0.1, -0.2, 0.3)))
    for each in (body, started):
        each.advance_to(SECOND)
    assert_same_state(body, started, atol=0.0)


@pytest.mark.parametrize("length", [0.0, 0.99, 1.01])
def test_refuses_an_attitude_not_of_unit_length(length: float) -> None:
    q = (0.0, 0.6 * length, 0.0, 0.8 * length)
    with pytest.raises(
        ConfigurationError, match=r"^simulator\.initial_attitude: given .*length 1"
    ):
        ideal(initial_attitude=q)


def test_heavier_vehicle_sinks_at_hover_throttle() -> None:
    sinking = {}
    for mass_scale in (1.0, 1.2):
        body = plant(mass_scale=mass_scale, drag=0.0)
        body.apply(command(HOVER))
        body.advance_to(SECOND)
        sinking[mass_scale] = 10.0 - body.state.p_WB[2]
    assert sinking[1.0] == pytest.approx(0.0, abs=1e-9)
    assert sinking[1.2] == pytest.approx(0.5 * 9.81 * (1.0 - 1.0 / 1.2), rel=1e-9)


@pytest.mark.parametrize(("asked", "given_throttle"), [(1.7, 1.0), (-0.5, 0.0)])
def test_throttle_saturates(asked: float, given_throttle: float) -> None:
    one, other = plant(), plant()
    one.apply(command(asked))
    other.apply(command(given_throttle))
    for each in (one, other):
        each.advance_to(SECOND // 10)
    assert_same_state(one, other, atol=0.0)


@pytest.mark.parametrize(
    "nonsense", [command(math.nan), command(math.inf), command(0.5, (0.0, math.nan, 0.0))]
)
def test_a_command_that_is_not_finite_is_ignored(nonsense: CommandSample) -> None:
    one, other = plant(), plant()
    for each in (one, other):
        each.apply(command(0.4, (0.1, 0.0, 0.0)))
    one.apply(nonsense)
    for each in (one, other):
        each.advance_to(SECOND // 10)
    assert_same_state(one, other, atol=0.0)


def test_landing_keeps_the_heading() -> None:
    body = plant(initial_position=(0.0, 0.0, 1.0), initial_attitude=HEADING_07)
    body.apply(command(0.0))
    body.advance_to(SECOND)
    assert body.state.p_WB[2] == 0.0
    assert_allclose(body.state.R_WB, Rotation.from_euler("z", 0.7).as_matrix(), atol=1e-12)
