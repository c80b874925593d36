# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A load on a cable: physical cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fixtures.rotors import command, configured
from fixtures.touching import (
    WEIGHT,
    after,
    cable_tension,
    contact_force,
    payload_place,
    standing,
)
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.extras.plants.mujoco.plant import MujocoPlant

pytest.importorskip("mujoco")

G = 9.81
LOAD = 0.0794  # kg, a fifth of the vehicle


def hovering(**changes: object) -> MujocoPlant:
    """Return a vehicle that carries itself and the load, without air."""
    body = standing(
        initial_position=(0.0, 0.0, 5.0),
        mujoco__payload__mass=LOAD,
        airframe__drag_linear=(0.0, 0.0, 0.0),
        airframe__ground_effect=0.0,
        **changes,
    )
    vehicle = body_vehicle()
    body.apply(command(vehicle.throttle_for((vehicle.mass + LOAD) * G)))
    return body


def body_vehicle() -> Vehicle:
    return configured().vehicle()


def period(times: Array, swing: Array) -> float:
    """Return the mean time from one upward crossing of zero to the next."""
    up = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0))
    share = -swing[up] / (swing[up + 1] - swing[up])
    crossings = times[up] + share * (times[1] - times[0])
    return float(np.diff(crossings).mean())


def swung(body: MujocoPlant, *, push: float, duration: float) -> tuple[Array, Array, Array]:
    """Return times, and places of the load and of the hook, of a load that was pushed [m/s]."""
    body.scene.data.joint("payload").qvel[0] = push
    times = np.arange(0.0, duration, 0.005)
    load, hook = [], []
    for _ in times:
        after(body, 0.005)
        load.append(payload_place(body))
        hook.append(body.state.p_WB)
    return times, np.array(load), np.array(hook)


def test_swings_as_a_pendulum_below_a_standing_vehicle() -> None:
    """The vehicle stands on legs of 2 m: 2 pi sqrt(l / g) (1 + theta^2 / 16)."""
    length = 1.0
    body = standing(
        airframe__clearance=2.0,
        mujoco__gear__length=3.0,
        mujoco__gear__width=3.0,
        mujoco__payload__mass=0.01,
        mujoco__payload__cable_length=length,
    )
    after(body, 0.2)
    theta = 0.1
    times, load, hook = swung(body, push=theta * math.sqrt(G * length), duration=8.0)
    expected = math.tau * math.sqrt(length / G) * (1.0 + theta**2 / 16.0)
    assert period(times, load[:, 0]) == pytest.approx(expected, rel=2e-3)
    assert_allclose(np.linalg.norm(load - hook, axis=1), length, rtol=1e-3)
    assert np.abs(load[-200:, 0]).max() == pytest.approx(theta * length, rel=0.02)


def test_swings_faster_below_a_hovering_vehicle() -> None:
    """Load and vehicle move against each other: omega^2 = g / l (1 + m / M) in hover."""
    body = hovering()
    after(body, 0.5)
    times, load, hook = swung(body, push=0.1, duration=8.0)
    apart = (load - hook)[:, 0]
    expected = math.tau / math.sqrt(G / 0.5 * (1.0 + LOAD / 0.396893))
    assert period(times, apart - apart.mean()) == pytest.approx(expected, rel=5e-3)


def test_lies_on_the_ground_until_the_cable_is_taut() -> None:
    body = standing(mujoco__payload__mass=LOAD)
    after(body, 0.5)
    assert cable_tension(body) == 0.0
    assert contact_force(body)[2] == pytest.approx(WEIGHT, rel=1e-3)  # not that of the load
    assert payload_place(body)[2] == pytest.approx(-0.05 + 0.01, abs=1e-4)
    body.apply(command(0.4))
    after(body, 1.5)
    assert cable_tension(body) > LOAD * G
    assert np.linalg.norm(payload_place(body) - body.state.p_WB) == pytest.approx(0.5, rel=1e-3)


def test_a_cable_does_not_push() -> None:
    """In free fall it is slack."""
    body = hovering()
    body.apply(command(0.0))
    after(body, 0.5)
    assert cable_tension(body) == pytest.approx(0.0, abs=1e-3)


def test_an_off_centre_load_tilts_the_vehicle() -> None:
    body = standing(
        initial_position=(0.0, 0.0, 5.0),
        initial_throttle=0.35,
        mujoco__payload__mass=LOAD,
        mujoco__payload__attachment=(0.05, 0.0, 0.0),
        rate_loop__p=(0.0, 0.0, 0.0),
        rate_loop__i=(0.0, 0.0, 0.0),
        rate_loop__d=(0.0, 0.0, 0.0),
    )
    body.apply(command(0.35))
    after(body, 0.1)
    assert body.odometry(0).w_WB_B[1] > 0.5  # nose down
