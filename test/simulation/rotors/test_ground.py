# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Ground contact and ground effect."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from fixtures.rotors import (
    NO_AIR,
    SECOND,
    VEHICLES,
    Equations,
    Flying,
    command,
    configured,
    plant,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.simulation.rotors.craft import BodyState
from quad_mpc_ros.simulation.rotors.equations import ground_gain

OFF_CENTRE: dict[str, Any] = {"airframe__center_of_mass": (0.01, -0.02, 0.03)}
GROUND: dict[str, Any] = {"initial_position": (1.0, 2.0, 0.0), "initial_throttle": 0.0}
HEADING = tuple(Rotation.from_euler("z", 0.7).as_quat())


def hover_throttle(name: str = "paper") -> float:
    return configured(name).vehicle().hover_throttle


@pytest.mark.parametrize("changes", [{}, OFF_CENTRE])
@pytest.mark.parametrize("throttle", [0.0, 0.8])
def test_stays_on_the_ground_without_enough_thrust(
    throttle: float, changes: dict[str, Any]
) -> None:
    """Upright and where it stands, in wind and whatever rates are commanded."""
    body = plant(**GROUND, **changes, initial_attitude=HEADING, wind=(4.0, 0.0, 0.0))
    before = body.odometry(0)
    body.apply(command(throttle * hover_throttle(), (3.0, -3.0, 2.0)))
    body.advance_to(2 * SECOND)
    seen = body.odometry(0)
    assert_allclose(seen.p_WB, [1.0, 2.0, 0.0], atol=1e-12)
    assert_array_equal(seen.p_WB, before.p_WB)
    assert_allclose(seen.q_WB_xyzw, HEADING, atol=1e-12)
    assert_array_equal(seen.v_WB_B, np.zeros(3))
    assert_array_equal(seen.w_WB_B, np.zeros(3))


@settings(deadline=None, max_examples=20)
@given(st.floats(0.0, 1.0), st.tuples(*[st.floats(-10.0, 10.0)] * 3), st.floats(0.0, 2.0))
def test_never_falls_through_the_ground(
    throttle: float, rates: tuple[float, float, float], height: float
) -> None:
    body = plant("crazyflie", **OFF_CENTRE, initial_position=(0.0, 0.0, height))
    body.apply(command(throttle, rates))
    for tick in range(1, 60):
        body.advance_to(tick * 50_000_000)
        assert body.state.p_WB[2] >= -1e-12
        assert np.isfinite(body.state.p_WB).all()


@pytest.mark.parametrize("name", VEHICLES)
def test_falls_lands_level_and_takes_off_again(name: str) -> None:
    tumbling = Rotation.from_euler("ZYX", [0.7, 0.3, -0.4])
    body = plant(
        name,
        initial_position=(0.0, 0.0, 0.5),
        initial_attitude=tuple(tumbling.as_quat()),
        initial_throttle=0.0,
    )
    body.apply(command(0.0))
    body.advance_to(SECOND)
    assert_array_equal(body.state.p_WB[2], 0.0)
    assert_array_equal(body.state.v_WB_B, np.zeros(3))
    assert_allclose(body.state.R_WB[:, 2], [0.0, 0.0, 1.0], atol=1e-12)
    body.apply(command(1.2 * hover_throttle(name)))
    body.advance_to(2 * SECOND)
    assert body.state.p_WB[2] > 0.2
    assert_allclose(body.state.R_WB[:, 2], [0.0, 0.0, 1.0], atol=1e-6)


def gain(height: float, *, upright: float = 1.0, **changes: Any) -> float:
    config = configured(**{"airframe__ground_effect": 1.0, **changes})
    return ground_gain(height, upright=upright, craft=Equations.of(config).craft[()])


def test_ground_effect_is_that_of_cheeseman_and_bennett() -> None:
    """Their figure: at a height of one radius 1/15 more thrust, at a half 1/3 more."""
    radius = 0.0635
    assert gain(radius) == pytest.approx(1.0 + 1.0 / 15.0)
    assert gain(0.5 * radius) == pytest.approx(1.0 + 1.0 / 3.0)
    assert gain(100.0 * radius) == pytest.approx(1.0, abs=1e-5)


def test_ground_effect_is_bounded_and_disabled_upside_down() -> None:
    for height in (1e-9, 0.0, -1.0):
        assert gain(height) == pytest.approx(1.5)
    assert gain(0.01, upright=-1.0) == 1.0
    assert gain(0.01, airframe__ground_effect=0.0) == 1.0
    assert np.all(np.diff([gain(z) for z in np.linspace(0.0, 0.5, 50)]) <= 0.0)


def test_ground_effect_lifts_in_hover() -> None:
    body = Equations.of(
        configured().updated({**NO_AIR, "airframe.ground_effect": 1.0, "airframe.clearance": 0.02})
    )
    x = Flying(
        BodyState.zeros(), np.full(len(body.rotors), math.sqrt(0.396893 * 9.81 / 4.0 / 1.21e-6))
    )
    x.body["q_WB_xyzw"], x.body["p_WC"] = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0435)
    lifted = body.rate(x, x.speeds.copy()).body["v_WC_W"]
    assert_allclose(lifted, [0.0, 0.0, 9.81 / 15.0], atol=1e-9)


def test_landing_keeps_the_heading() -> None:
    body = plant(initial_position=(0.0, 0.0, 0.5), initial_attitude=HEADING, initial_throttle=0.0)
    body.advance_to(SECOND)
    assert_allclose(body.odometry(0).q_WB_xyzw, HEADING, atol=1e-12)
