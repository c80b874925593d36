# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A moving deck: physical cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fixtures.rotors import command
from fixtures.touching import WEIGHT, after, contact_force, places, standing, tilt

pytest.importorskip("mujoco")

TOP = 0.5
ON_DECK = {
    "initial_position": (0.0, 0.0, TOP + 0.05),
    "mujoco__deck__size": (2.0, 2.0),
    "mujoco__deck__position": (0.0, 0.0, TOP),
}


def test_a_heaving_deck_carries_the_vehicle() -> None:
    amplitude, frequency = 0.2, 0.4
    body = standing(
        **{**ON_DECK, "initial_position": (0.0, 0.0, TOP + 0.05 - amplitude)},
        mujoco__deck__heave_amplitude=amplitude,
        mujoco__deck__heave_frequency=frequency,
        mujoco__deck__heave_phase=-0.5 * math.pi,  # starts at the bottom, at rest
    )
    times, flown = places(body, duration=5.0)
    deck = -amplitude * np.cos(math.tau * frequency * times)
    above = flown[:, 2] - 0.05 - TOP - deck
    assert np.abs(above).max() < 5e-4
    assert np.abs(flown[:, :2]).max() < 1e-6
    assert tilt(body) < 1e-6


def test_contact_force_on_a_heaving_deck_is_weight_and_inertia() -> None:
    """N = m (g + a): heaviest at the bottom, lightest on top."""
    amplitude, frequency = 0.2, 0.5
    body = standing(
        **ON_DECK,
        mujoco__deck__heave_amplitude=amplitude,
        mujoco__deck__heave_frequency=frequency,
    )
    a = amplitude * (math.tau * frequency) ** 2
    top = contact_force(after(body, 0.5))[2]
    bottom = contact_force(after(body, 1.0))[2]
    assert top == pytest.approx(WEIGHT * (1.0 - a / 9.81), rel=0.01)
    assert bottom == pytest.approx(WEIGHT * (1.0 + a / 9.81), rel=0.01)


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_a_rocking_deck_tilts_the_vehicle(axis: str) -> None:
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


def test_ground_effect_depends_on_the_height_above_the_deck() -> None:
    """The same climb, half a metre higher."""
    climbs = []
    for higher, given in ((0.0, {}), (TOP + 0.05, ON_DECK)):
        body = standing(**{**given, "initial_position": (0.0, 0.0, 0.03 + higher)})
        body.apply(command(0.32))
        climbs.append(after(body, 0.6).state.p_WB[2] - higher)
    assert climbs[0] == pytest.approx(climbs[1], abs=1e-6)
