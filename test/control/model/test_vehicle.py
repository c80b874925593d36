# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The throttle curve against the paper's numbers and against itself."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.model.vehicle import Vehicle, VehicleParameters

OUNCE = 0.028349523125


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle()


def test_the_default_is_the_papers_quadrotor(vehicle: Vehicle) -> None:
    assert vehicle.mass == pytest.approx(14.0 * OUNCE, abs=5e-7)
    assert vehicle.drag == 0.2
    assert vehicle.thrust_curve == (1.87953563, 2.79829004, -0.00514948)


def test_hover_throttle_of_the_paper(vehicle: Vehicle) -> None:
    assert vehicle.hover_throttle == pytest.approx(0.2923008, abs=1e-7)


def test_hover_thrust_equals_weight(vehicle: Vehicle) -> None:
    assert vehicle.thrust(vehicle.hover_throttle) == pytest.approx(0.396893 * 9.81, rel=1e-14)


curves = st.tuples(
    st.one_of(st.just(0.0), st.floats(1e-12, 50.0)),
    st.one_of(st.just(0.0), st.floats(1e-3, 50.0)),
    st.floats(-0.01, 0.01),
).filter(lambda curve: curve[0] + curve[1] > 1.0)


@settings(deadline=None)
@given(curves, st.integers(1, 8), st.floats(0.0, 1.0))
def test_throttle_inverts_thrust(
    curve: tuple[float, float, float], motor_count: int, throttle: float
) -> None:
    vehicle = Vehicle(thrust_curve=curve, motor_count=motor_count, mass=0.05)
    thrust = vehicle.thrust(throttle)
    found = vehicle.throttle_for(thrust)
    assert 0.0 <= found <= 1.0
    assert vehicle.thrust(found) == pytest.approx(thrust, abs=1e-12)
    if curve[1] > 0.0:
        assert found == pytest.approx(throttle, abs=1e-11)


def test_inverts_a_curve_with_zero_initial_slope() -> None:
    vehicle = Vehicle(thrust_curve=(4.0, 0.0, 0.0))
    assert vehicle.throttle_for(0.0) == 0.0


def test_inverts_a_linear_curve() -> None:
    vehicle = Vehicle(thrust_curve=(0.0, 4.0, 0.0), motor_count=2)
    assert vehicle.throttle_for(2.0) == pytest.approx(0.25, rel=1e-15)


@pytest.mark.parametrize("thrust", [-0.03, 18.7, -5.0, 1e9, math.nan, math.inf])
def test_rejects_thrust_beyond_the_throttle_range(vehicle: Vehicle, thrust: float) -> None:
    with pytest.raises(ValueError, match=r"in \[0, 1\], -0\.0205979 N to 18\.6907 N"):
        vehicle.throttle_for(thrust)


def test_a_vehicle_too_heavy_for_its_motors_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"mass: given 2\.0, expected .* 18\.69 N"):
        Vehicle(mass=2.0)


def test_rejects_a_vehicle_that_lifts_off_at_idle() -> None:
    with pytest.raises(ConfigurationError, match="mass"):
        Vehicle(thrust_curve=(1.0, 1.0, 5.0))


@pytest.mark.parametrize("curve", [(-1.0, 3.0, 0.0), (1.0, -0.1, 0.0), (0.0, 0.0, 1.0)])
def test_a_curve_that_does_not_rise_is_refused(curve: tuple[float, float, float]) -> None:
    with pytest.raises(ConfigurationError, match=r"thrust_curve.*thrust rises with throttle"):
        VehicleParameters(thrust_curve=curve)
