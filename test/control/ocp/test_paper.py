# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A and B against finite differences of the error dynamics, taken through ⊞ and ⊟."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fixtures.box_plus import boxplus
from fixtures.plant_motion import rate
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import Input, State, boxminus
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.ocp.paper import error_dynamics

VEHICLE = Vehicle()
UNEVEN = Vehicle(drag=(0.3, 0.15, 0.45))


def error_rate(x: State, u: Input, x_error: Array, u_error: Array, vehicle: Vehicle) -> Array:
    """Return d/dt (x_r ⊟ x) with x_r = x ⊞ x_error and u_r = u + u_error, both flying Eq. (3)."""
    x_r = boxplus(x, x_error)
    u_r = Input(throttle=u.throttle + u_error[0], w_WB_B=u.w_WB_B + u_error[1:])
    f = rate(x, u, vehicle, dynamics="paper")
    f_r = rate(x_r, u_r, vehicle, dynamics="paper")

    def error_after(step: float) -> Array:
        return boxminus(boxplus(x_r, step * f_r), boxplus(x, step * f))

    step = 1e-4
    return (error_after(step) - error_after(-step)) / (2.0 * step)


def derivative(function: Callable[[Array], Array], size: int) -> Array:
    step = 1e-4
    columns = [(function(step * e) - function(-step * e)) / (2.0 * step) for e in np.eye(size)]
    return np.stack(columns, axis=-1)


def drawn(seed: int) -> tuple[State, float, Array]:
    rng = np.random.default_rng(seed)
    x = State(
        p_WB=rng.normal(size=3),
        v_WB_B=rng.normal(scale=3.0, size=3),
        R_WB=Rotation.from_quat(rng.normal(size=4)).as_matrix(),
    )
    return x, float(rng.uniform(0.05, 1.0)), rng.normal(scale=3.0, size=3)


cases = st.integers(0, 2**32 - 1).map(drawn)


@settings(deadline=None)
@given(cases, st.floats(0.0, 1.0))
def test_B_of_the_paper_is_the_slope_at_the_reference_throttle(
    case: tuple[State, float, Array], reference: float
) -> None:
    x, throttle, _ = case
    _, B = error_dynamics(x, VEHICLE, throttle=throttle, throttle_error=reference - throttle)
    slope = 4.0 * (2.0 * 1.87953563 * reference + 2.79829004) / 0.396893
    assert B[5, 0] == pytest.approx(slope, rel=1e-13)


def test_A_and_B_as_printed_for_level_flight_north() -> None:
    north = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    x = State(p_WB=np.zeros(3), v_WB_B=np.array([2.0, 0.0, 0.0]), R_WB=north)
    A, B = error_dynamics(x, VEHICLE, throttle=0.5, throttle_error=0.0)
    expected = np.zeros((9, 9))
    expected[0:3, 3:6] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    # -R [v]: a yaw error to the left of the flight north leads west, nose down leads down.
    expected[0:3, 6:9] = [[0, 0, -2], [0, 0, 0], [0, -2, 0]]
    expected[3:6, 3:6] = -0.2 * np.eye(3)
    # [R'g]: nose down (+y) accelerates forwards, left side up (+x) to the right.
    expected[3:6, 6:9] = [[0, 9.81, 0], [-9.81, 0, 0], [0, 0, 0]]
    assert_allclose(A, expected, atol=1e-14)
    assert_array_equal(B[:5], np.zeros((5, 4)))
    assert_array_equal(B[6:], np.hstack((np.zeros((3, 1)), np.eye(3))))
    assert_array_equal(B[5, 1:], np.zeros(3))
    assert B[5, 0] > 0.0


@settings(deadline=None, max_examples=50)
@given(cases, st.sampled_from([VEHICLE, UNEVEN]), st.sampled_from([0.0, 1.0]))
def test_the_paper_drops_only_the_rotation_of_the_attitude_error(
    case: tuple[State, float, Array], vehicle: Vehicle, turns: float
) -> None:
    """At zero body rate A and B are the derivatives."""
    x, throttle, w = case[0], case[1], turns * case[2]
    u = Input(throttle=throttle, w_WB_B=w)
    A, B = error_dynamics(x, vehicle, throttle=throttle, throttle_error=0.0)
    turning = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    dropped = np.zeros((9, 9))
    dropped[6:, 6:] = -turning
    by_state = derivative(lambda error: error_rate(x, u, error, np.zeros(4), vehicle), 9)
    by_input = derivative(lambda error: error_rate(x, u, np.zeros(9), error, vehicle), 4)
    assert_allclose(A + dropped, by_state, rtol=0.0, atol=2e-5)
    assert_allclose(B, by_input, rtol=0.0, atol=2e-5)
