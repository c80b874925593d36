# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Ground contact: physical cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fixtures.rotors import command
from fixtures.touching import WEIGHT, after, contact_force, places, standing, tilt
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.extras.plants.mujoco.drive import Drive
from quad_mpc_ros.simulation.rotors.craft import BodyState

pytest.importorskip("mujoco")

FEET = frozenset({"foot0", "foot1", "foot2", "foot3"})
NO_AIR = {"airframe__drag_linear": (0.0, 0.0, 0.0)}
FRICTION = 0.5
STICKS = math.atan(FRICTION)
STABLE = {"mujoco__gear__length": 0.3, "mujoco__gear__width": 0.3}


def test_rests_on_its_feet_with_its_weight() -> None:
    body = after(standing(), 1.0)
    assert body.scene.touching() == FEET
    assert_allclose(contact_force(body), [0.0, 0.0, WEIGHT], atol=2e-4 * WEIGHT)
    assert_allclose(body.state.p_WB, np.zeros(3), atol=2e-5)
    assert np.linalg.norm(body.v_WB_W) < 1e-9
    assert tilt(body) < 1e-9


def test_sticks_on_a_slope_below_the_angle_of_friction() -> None:
    slope = STICKS - math.radians(1.0)
    body = standing(
        mujoco__ground__slope=slope,
        mujoco__ground__slope_heading=2.0,
        mujoco__contact__friction=FRICTION,
        **STABLE,
    )
    body.apply(command(0.0))
    begun = after(body, 0.2).state.p_WB
    slid = np.linalg.norm(after(body, 2.0).state.p_WB - begun)
    assert slid < 1e-3  # a sticking vehicle creeps by 0.1 mm/s
    assert tilt(body) == pytest.approx(slope, abs=1e-3)
    assert body.scene.touching() == FEET


def test_slides_down_a_slope_above_the_angle_of_friction() -> None:
    """With a = g (sin - mu cos), straight downhill, the friction accurate to 1 %."""
    slope, heading = STICKS + math.radians(5.0), 2.0
    body = standing(
        mujoco__ground__slope=slope,
        mujoco__ground__slope_heading=heading,
        mujoco__contact__friction=FRICTION,
        **STABLE,
        **NO_AIR,
    )
    begun = body.state.p_WB
    moved = after(body, 1.0).state.p_WB - begun
    way = -np.array(
        [
            math.cos(slope) * math.cos(heading),
            math.cos(slope) * math.sin(heading),
            math.sin(slope),
        ]
    )
    friction = FRICTION * 9.81 * math.cos(slope)
    slowed = 9.81 * math.sin(slope) - 2.0 * moved @ way
    assert slowed == pytest.approx(friction, rel=0.01)
    assert np.linalg.norm(moved - (moved @ way) * way) < 0.02 * moved @ way


@pytest.mark.parametrize("margin", [-2.0, 2.0])
def test_tips_over_when_the_centre_of_mass_is_outside_the_gear(margin: float) -> None:
    """Half of a gear of 6 cm at 5 cm of height: at atan(3 / 5) = 31 degrees."""
    slope = math.atan(0.03 / 0.05) + math.radians(margin)
    body = standing(
        mujoco__ground__slope=slope,
        mujoco__contact__friction=3.0,
        mujoco__gear__length=0.06,
        mujoco__gear__width=0.06,
    )
    body.apply(command(0.0))
    after(body, 2.0)
    if margin < 0.0:
        assert body.scene.touching() == FEET
        assert tilt(body) == pytest.approx(slope, abs=1e-3)
    else:
        assert tilt(body) > slope + math.radians(15.0)
        assert any(part.startswith("rotor") for part in body.scene.touching())


def test_falls_from_a_height_onto_its_feet() -> None:
    """With the speed of a free fall, sqrt(2 g h), and without bouncing."""
    body = standing(initial_position=(0.0, 0.0, 0.2), **NO_AIR)
    body.apply(command(0.0))
    after(body, math.sqrt(2.0 * 0.2 / 9.81) - 1e-3)
    assert body.v_WB_W[2] == pytest.approx(-math.sqrt(2.0 * 9.81 * 0.2), rel=0.01)
    _, flown = places(body, duration=1.0)
    assert flown[:, 2].max() < 0.03
    assert body.scene.touching() == FEET
    assert tilt(body) < 0.01


def test_bounces_with_a_low_damping_ratio() -> None:
    heights = []
    for ratio in (1.0, 0.2):
        body = standing(
            initial_position=(0.0, 0.0, 0.2), mujoco__contact__damping_ratio=ratio, **NO_AIR
        )
        body.apply(command(0.0))
        after(body, 0.25)
        heights.append(places(body, duration=0.5)[1][:, 2].max())
    assert heights[1] > 0.05 > heights[0]


def test_lies_on_its_rotors_upside_down() -> None:
    """Thrust then presses the vehicle down: the contacts carry its weight and the thrust."""
    body = standing(initial_position=(0.0, 0.0, 0.1), initial_attitude=(1.0, 0.0, 0.0, 0.0))
    after(body, 1.0)
    assert body.scene.touching() == {f"rotor{number}" for number in range(4)}
    assert_allclose(contact_force(body), [0.0, 0.0, WEIGHT], atol=1e-3 * WEIGHT)
    body.apply(command(0.3))
    assert contact_force(after(body, 1.0))[2] > 1.9 * WEIGHT


def test_starts_tilted_like_the_ground() -> None:
    """Anywhere on a slope, with the configured heading."""
    slope, heading = math.radians(20.0), 0.5
    attitude = tuple(so3.quaternion_xyzw_from_rotation(so3.exp(np.array([0.0, 0.0, 1.0]))))
    body = standing(
        initial_position=(2.0, -1.0, 0.0),
        initial_attitude=attitude,
        mujoco__ground__slope=slope,
        mujoco__ground__slope_heading=heading,
    )
    up = np.array(
        [
            -math.sin(slope) * math.cos(heading),
            -math.sin(slope) * math.sin(heading),
            math.cos(slope),
        ]
    )
    assert_allclose(body.state.R_WB[:, 2], up, atol=1e-12)
    assert_allclose(body.state.p_WB @ up, 0.0, atol=1e-12)
    assert_allclose(body.state.p_WB[:2], [2.0, -1.0])
    after(body, 0.5)
    assert body.scene.touching() == FEET


def test_no_rotor_is_below_the_ground_by_rounding() -> None:
    """In this state MuJoCo finds a disc 1 mm below a plane that is parallel 5 cm below it.

    Found at random: rates of 1e-13 rad/s make the difference. The rotors therefore are no discs.
    """
    body, scene = BodyState.zeros(), standing().scene
    body["q_WB_xyzw"] = (
        -1.8583350258156615e-15,
        -3.6730684736726456e-16,
        0.3657384277913674,
        0.9307176813817909,
    )
    body["w_WB_B"] = 5.827945580423224e-16, -1.626044366294472e-13, -7.91779109582741e-14
    scene.put(body)
    scene.step(Drive.zeros(), body, at=0.0, duration=1e-3)
    assert scene.touching() <= FEET
