"""A deck that moves, and walls: physical cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fixtures.rotors import command
from fixtures.touching import WEIGHT, after, places, standing, tilt

pytest.importorskip("mujoco")

TOP = 0.5
ON_DECK = {
    "initial_position": (0.0, 0.0, TOP + 0.05),
    "mujoco__deck__size": (2.0, 2.0),
    "mujoco__deck__position": (0.0, 0.0, TOP),
}


def test_a_deck_carries_it_up_and_down() -> None:
    amplitude, frequency = 0.2, 0.4
    body = standing(
        **{**ON_DECK, "initial_position": (0.0, 0.0, TOP + 0.05 - amplitude)},
        mujoco__deck__heave_amplitude=amplitude,
        mujoco__deck__heave_frequency=frequency,
        mujoco__deck__heave_phase=-0.5 * math.pi,  # it begins below, at rest
    )
    times, flown = places(body, duration=5.0)
    deck = -amplitude * np.cos(math.tau * frequency * times)
    above = flown[:, 2] - 0.05 - TOP - deck
    assert np.abs(above).max() < 5e-4
    assert np.abs(flown[:, :2]).max() < 1e-6
    assert tilt(body) < 1e-6


def test_the_force_of_a_deck_is_weight_and_inertia() -> None:
    """N = m (g + a): heaviest at the bottom, lightest on top."""
    amplitude, frequency = 0.2, 0.5
    body = standing(
        **ON_DECK,
        mujoco__deck__heave_amplitude=amplitude,
        mujoco__deck__heave_frequency=frequency,
    )
    a = amplitude * (math.tau * frequency) ** 2
    top = after(body, 0.5).contact_force_W[2]
    bottom = after(body, 1.0).contact_force_W[2]
    assert top == pytest.approx(WEIGHT * (1.0 - a / 9.81), rel=0.01)
    assert bottom == pytest.approx(WEIGHT * (1.0 + a / 9.81), rel=0.01)


def test_a_deck_that_falls_away_is_left_behind() -> None:
    """Where it is to sink faster than by g the vehicle flies off."""
    body = standing(
        **ON_DECK, mujoco__deck__heave_amplitude=0.1, mujoco__deck__heave_frequency=2.0
    )
    times, flown = places(body, duration=0.3)
    deck = 0.1 * np.sin(math.tau * 2.0 * times)
    assert (flown[:, 2] - 0.05 - TOP - deck).max() > 0.02


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_a_rocking_deck_tilts_what_stands_on_it(axis: str) -> None:
    amplitude, frequency = math.radians(5.0), 0.25
    body = standing(
        **ON_DECK,
        **{f"mujoco__deck__{axis}_amplitude": amplitude},
        mujoco__deck__rock_frequency=frequency,
    )
    after(body, 1.0)  # a quarter of a period
    x, y, _ = body.state.R_WB[:, 2]
    leaning = {"roll": -y, "pitch": x}[axis]  # REP-103: roll leans right, pitch forwards
    assert math.asin(leaning) == pytest.approx(amplitude, abs=1e-3)
    assert abs({"roll": x, "pitch": -y}[axis]) < 1e-3
    assert np.abs(body.odometry(0).w_WB_B).max() < 0.01
    after(body, 1.0)
    rate = body.odometry(0).w_WB_B[{"roll": 0, "pitch": 1}[axis]]
    assert rate == pytest.approx(-amplitude * math.tau * frequency, rel=0.02)


def test_slips_off_a_deck_that_rocks_beyond_friction() -> None:
    body = standing(
        **ON_DECK,
        mujoco__deck__roll_amplitude=math.radians(30.0),
        mujoco__contact__friction=0.3,
        mujoco__gear__length=0.3,
        mujoco__gear__width=0.3,
    )
    after(body, 4.0)
    assert np.abs(body.state.p_WB[1]) > 0.1


def test_ground_effect_is_above_a_deck_as_above_the_ground() -> None:
    """The same climb, half a metre higher."""
    climbs = []
    for higher, given in ((0.0, {}), (TOP + 0.05, ON_DECK)):
        body = standing(**{**given, "initial_position": (0.0, 0.0, 0.03 + higher)})
        body.apply(command(0.32))
        climbs.append(after(body, 0.6).state.p_WB[2] - higher)
    assert climbs[0] == pytest.approx(climbs[1], abs=1e-6)


def test_a_wall_stops_it() -> None:
    """A wall across the way, its face 1.95 m ahead; rotors reach 0.1413 m from the middle."""
    body = standing(
        initial_position=(0.0, 0.0, 1.0),
        initial_velocity=(3.0, 0.0, 0.0),
        initial_throttle=0.29,
        mujoco__walls__x=(2.0,),
        mujoco__walls__y=(0.0,),
        mujoco__walls__heading=(math.pi / 2.0,),
        mujoco__walls__length=(4.0,),
    )
    body.apply(command(0.29))
    _, flown = places(body, duration=2.0)
    reach = flown[:, 0].max() + 0.0778 + 0.0635
    assert 1.95 < reach < 1.97
    assert body.v_WB_W[0] < 0.0


def test_flies_on_beside_a_wall() -> None:
    body = standing(
        initial_position=(0.0, 0.0, 1.0),
        initial_velocity=(3.0, 0.0, 0.0),
        initial_throttle=0.29,
        mujoco__walls__x=(2.0,),
        mujoco__walls__y=(1.0,),
        mujoco__walls__heading=(0.0,),
        mujoco__walls__length=(4.0,),
    )
    body.apply(command(0.29))
    after(body, 2.0)
    assert body.state.p_WB[0] > 3.0
    assert not body.touching
