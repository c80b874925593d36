"""What the mixer promises of any number of rotors, with and without airmode."""

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
WISHES = st.tuples(
    st.floats(-5.0, 30.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.3, 0.3)
)
COUNTS = st.sampled_from([4, 6, 8])


def ring(rotor_count: int, *, tilt: float = 0.0) -> RotorParameters:
    """Rotors on a ring that turn in turn, each tilted about its arm."""
    angles = (np.arange(rotor_count) + 0.5) * 2.0 * math.pi / rotor_count
    signs = (-1.0) ** np.arange(rotor_count)
    return RotorParameters(
        x=tuple(0.15 * np.cos(angles)),
        y=tuple(0.15 * np.sin(angles)),
        z=(0.0,) * rotor_count,
        tilt_x=tuple(tilt * signs * np.cos(angles)),
        tilt_y=tuple(tilt * signs * np.sin(angles)),
        spin=tuple(signs),
        torque_coefficient=2e-8,
    )


def mix(
    rotors: RotorParameters, wish: tuple[float, float, float, float], *, airmode: bool
) -> tuple[Array, Array, tuple[float, float]]:
    """Return the thrusts, what they give together, and the shares."""
    out = np.empty(len(rotors.x))
    shares = mixed(
        wish[0], torque=wish[1:], mix=mixing(rotors), limits=LIMITS, airmode=airmode, out=out
    )
    return out, allocation(rotors) @ out, shares


@settings(deadline=None)
@given(COUNTS, WISHES, st.booleans())
def test_no_rotor_is_asked_for_what_it_cannot_give(
    rotor_count: int, wish: tuple[float, float, float, float], airmode: bool
) -> None:
    thrusts, given, shares = mix(ring(rotor_count), wish, airmode=airmode)
    assert (thrusts >= LIMITS[0]).all()
    assert (thrusts <= LIMITS[1]).all()
    assert all(0.0 <= share <= 1.0 for share in shares)
    # Torque is less than wished, but never another one.
    assert_allclose(given[1:3], shares[0] * np.array(wish[1:3]), atol=1e-9)
    assert given[3] == pytest.approx(shares[1] * wish[3], abs=1e-9)


@settings(deadline=None)
@given(COUNTS, st.floats(0.4, 0.6), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.booleans())
def test_what_the_rotors_can_give_is_given(
    rotor_count: int, level: float, roll: float, pitch: float, airmode: bool
) -> None:
    wish = (level * 4.0 * rotor_count, roll, pitch, 0.01)
    _, given, shares = mix(ring(rotor_count, tilt=0.2), wish, airmode=airmode)
    assert shares == (1.0, 1.0)
    assert_allclose(given, wish, atol=1e-9)


@settings(deadline=None)
@given(COUNTS, WISHES)
def test_without_airmode_the_thrust_stays(
    rotor_count: int, wish: tuple[float, float, float, float]
) -> None:
    _, given, _ = mix(ring(rotor_count), wish, airmode=False)
    lowest, highest = rotor_count * LIMITS[0], rotor_count * LIMITS[1]
    assert given[0] == pytest.approx(min(max(wish[0], lowest), highest), abs=1e-9)


@settings(deadline=None)
@given(COUNTS, WISHES)
def test_with_airmode_torque_is_lost_only_where_no_thrust_allows_it(
    rotor_count: int, wish: tuple[float, float, float, float]
) -> None:
    """Of which there is one unless the torque needs more than the whole range of the rotors."""
    rotors = ring(rotor_count)
    _, _, (share, _) = mix(rotors, wish, airmode=True)
    shares = mixing(rotors)
    turn = shares["roll"] * wish[1] + shares["pitch"] * wish[2]
    span = max(turn.max() - turn.min(), LIMITS[1] - LIMITS[0])
    assert share == pytest.approx((LIMITS[1] - LIMITS[0]) / span)


@pytest.mark.parametrize("throttle", [0.0, 100.0])
def test_airmode_turns_at_no_and_at_full_thrust(throttle: float) -> None:
    wish = (throttle, 0.2, -0.1, 0.005)
    _, given, _ = mix(ring(4), wish, airmode=True)
    assert_allclose(given[1:], wish[1:], atol=1e-9)
    _, given, _ = mix(ring(4), wish, airmode=False)
    assert_allclose(given[1:], np.zeros(3), atol=1e-9)


def test_a_rotor_ahead_lifts_the_nose_and_one_on_the_left_rolls_right() -> None:
    """FLU: roll about forwards drops the right side when positive, pitch the nose."""
    given = allocation(ring(4))
    ahead, left = np.array(ring(4).x) > 0.0, np.array(ring(4).y) > 0.0
    assert (given[0] == 1.0).all()
    assert (given[1, left] > 0.0).all()
    assert (given[2, ahead] < 0.0).all()


def test_a_rotor_that_turns_anticlockwise_turns_the_body_clockwise() -> None:
    assert (np.sign(allocation(ring(4))[3]) == -np.array(ring(4).spin)).all()


def test_rotors_that_cannot_turn_it_are_refused() -> None:
    alike = RotorParameters(spin=(1.0, 1.0, 1.0, 1.0))
    line = RotorParameters(y=(0.0, 0.0, 0.0, 0.0))
    mixing(RotorParameters())
    for rotors in (line, alike):
        with pytest.raises(ConfigurationError, match=r"^simulator\.rotors\.x"):
            mixing(rotors)
