# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Properties of the mixer for any number of rotors, with and without airmode."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.rotors.mixer import allocation, mixed, mixing
from quad_mpc_ros.simulation.rotors.parameters import RotorParameters

LIMITS = (0.2, 4.0)
DEMANDS = st.tuples(
    st.floats(-5.0, 30.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.3, 0.3)
)
COUNTS = st.sampled_from([4, 6, 8])


def ring(rotor_count: int) -> RotorParameters:
    """Return rotors on a ring with alternating spins."""
    angles = (np.arange(rotor_count) + 0.5) * 2.0 * math.pi / rotor_count
    signs = (-1.0) ** np.arange(rotor_count)
    return RotorParameters(
        x=tuple(0.15 * np.cos(angles)),
        y=tuple(0.15 * np.sin(angles)),
        z=(0.0,) * rotor_count,
        spin=tuple(signs),
        torque_coefficient=2e-8,
    )


def mix(
    rotors: RotorParameters, demand: tuple[float, float, float, float], *, airmode: bool
) -> tuple[Array, Array, tuple[float, float]]:
    """Return the thrusts, what they give together, and the shares."""
    out = np.empty(len(rotors.x))
    shares = mixed(
        demand[0], torque=demand[1:], mix=mixing(rotors), limits=LIMITS, airmode=airmode, out=out
    )
    return out, allocation(rotors) @ out, shares


@settings(deadline=None)
@given(COUNTS, DEMANDS, st.booleans())
def test_thrusts_stay_within_their_limits(
    rotor_count: int, demand: tuple[float, float, float, float], airmode: bool
) -> None:
    thrusts, given, shares = mix(ring(rotor_count), demand, airmode=airmode)
    assert (thrusts >= LIMITS[0]).all()
    assert (thrusts <= LIMITS[1]).all()
    assert all(0.0 <= share <= 1.0 for share in shares)
    # Torque is less than demanded, but never another one.
    assert_allclose(given[1:3], shares[0] * np.array(demand[1:3]), atol=1e-9)
    assert given[3] == pytest.approx(shares[1] * demand[3], abs=1e-9)


@settings(deadline=None)
@given(COUNTS, st.floats(0.4, 0.6), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.booleans())
def test_feasible_demands_are_met(
    rotor_count: int, level: float, roll: float, pitch: float, airmode: bool
) -> None:
    demand = (level * 4.0 * rotor_count, roll, pitch, 0.01)
    _, given, shares = mix(ring(rotor_count), demand, airmode=airmode)
    assert shares == (1.0, 1.0)
    assert_allclose(given, demand, atol=1e-9)


@settings(deadline=None)
@given(COUNTS, DEMANDS)
def test_airmode_keeps_torque_where_any_thrust_allows_it(
    rotor_count: int, demand: tuple[float, float, float, float]
) -> None:
    """Of which there is one unless the torque needs more than the whole range of the rotors."""
    rotors = ring(rotor_count)
    _, _, (share, _) = mix(rotors, demand, airmode=True)
    shares = mixing(rotors)
    turn = shares[:, 1] * demand[1] + shares[:, 2] * demand[2]
    span = max(turn.max() - turn.min(), LIMITS[1] - LIMITS[0])
    assert share == pytest.approx((LIMITS[1] - LIMITS[0]) / span)


def test_a_rotor_ahead_lifts_the_nose_and_one_on_the_left_rolls_right() -> None:
    """FLU: roll about forwards drops the right side when positive, pitch the nose."""
    given = allocation(ring(4))
    ahead, left = np.array(ring(4).x) > 0.0, np.array(ring(4).y) > 0.0
    assert (given[0] == 1.0).all()
    assert (given[1, left] > 0.0).all()
    assert (given[2, ahead] < 0.0).all()


def test_a_rotor_that_turns_anticlockwise_turns_the_body_clockwise() -> None:
    assert (np.sign(allocation(ring(4))[3]) == -np.array(ring(4).spin)).all()


def test_refuses_rotors_without_torque_about_every_axis() -> None:
    alike = RotorParameters(spin=(1.0, 1.0, 1.0, 1.0))
    line = RotorParameters(y=(0.0, 0.0, 0.0, 0.0))
    mixing(RotorParameters())
    for rotors in (line, alike):
        with pytest.raises(ConfigurationError, match=r"^simulator\.rotors\.x"):
            mixing(rotors)
