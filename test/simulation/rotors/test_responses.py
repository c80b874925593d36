# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Flights with closed-form solutions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from fixtures.rotors import (
    MILLISECOND,
    NO_AIR,
    SECOND,
    VEHICLES,
    command,
    configured,
    plant,
    vehicle_config,
)
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.recordings.evaluation.simulated import simulate
from quad_mpc_ros.simulation.config import make_plant
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant

GRAVITY = 9.81
DRAGLESS: dict[str, Any] = {name.replace(".", "__"): value for name, value in NO_AIR.items()}


@pytest.mark.parametrize("name", VEHICLES)
def test_hovers_at_hover_throttle(name: str) -> None:
    body = plant(name)
    body.advance_to(SECOND)
    assert_allclose(body.state.p_WB, [0.0, 0.0, 50.0], atol=1e-6)
    assert_allclose(body.state.v_WB_B, np.zeros(3), atol=1e-6)


@pytest.mark.parametrize("tau", [0.005, 0.03, 0.1])
def test_rotors_follow_with_their_lag(tau: float) -> None:
    body = plant(rotors__time_constant=tau)
    before = body.rotor_speeds
    body.apply(command(0.6))
    body.advance_to(5 * SECOND)
    settled = body.rotor_speeds
    body = plant(rotors__time_constant=tau)
    body.apply(command(0.6))
    for time_ms in (1, 7, 40):
        body.advance_to(time_ms * MILLISECOND)
        left = math.exp(-time_ms * 1e-3 / tau)
        assert_allclose(body.rotor_speeds, settled + left * (before - settled), rtol=1e-4)


@pytest.mark.parametrize(("lasting", "pushed"), [(0.2003, 0.2003), (0.0, 0.5896)])
def test_a_push_gives_its_momentum(lasting: float, pushed: float) -> None:
    """From when it begins, between two turns of the rate loop too, until it ends."""
    force = (3.0, -2.0, 1.0)
    body = plant(**DRAGLESS, push__force=force, push__begin=0.4104, push__duration=lasting)
    body.advance_to(410_400_000)
    assert_allclose(body.state.v_WB_W, np.zeros(3), atol=1e-9)
    body.advance_to(SECOND)
    assert_allclose(body.state.v_WB_W, pushed / 0.396893 * np.array(force), atol=1e-9)


@pytest.mark.parametrize("d", [0.0, 0.8])
def test_small_rate_step_is_a_second_order_response(d: float) -> None:
    """p / tau over s^2 + (1 + d) s / tau + p / tau: the rotors' lag within the loop."""
    p, tau, step = 40.0, 0.03, 0.01
    body = plant(
        **{
            **DRAGLESS,
            "rotors__time_constant": tau,
            "rate_loop__rate": 8000.0,
            "rate_loop__p": (p, p, 1.0),
            "rate_loop__i": (0.0, 0.0, 0.0),
            "rate_loop__d": (d, d, 0.0),
            "rate_loop__d_cutoff": 0.0,
        }
    )
    body.apply(command(configured().vehicle().hover_throttle, (step, 0.0, 0.0)))
    decay = (1.0 + d) / (2.0 * tau)
    frequency = math.sqrt(p / tau - decay * decay)
    for time_ms in range(5, 200, 5):
        body.advance_to(time_ms * MILLISECOND)
        t = time_ms * 1e-3
        ringing = math.cos(frequency * t) + decay / frequency * math.sin(frequency * t)
        expected = step * (1.0 - math.exp(-decay * t) * ringing)
        assert body.odometry(0).w_WB_B[0] == pytest.approx(expected, abs=0.01 * step)


@pytest.mark.parametrize("integral", [0.0, 100.0])
def test_integral_compensates_an_offset_centre_of_mass(integral: float) -> None:
    """Without it the error is what makes the torque: m g c over P and the inertia."""
    offset = 0.001
    body = plant(
        **{
            **DRAGLESS,
            "airframe__center_of_mass": (offset, 0.0, 0.0),
            "rate_loop__i": (integral, integral, 0.0),
        }
    )
    body.advance_to(3 * SECOND)
    torque = 0.396893 * GRAVITY * offset
    expected = 0.0 if integral else torque / (60.0 * 6.9e-4)
    assert body.odometry(0).w_WB_B[1] == pytest.approx(expected, abs=2e-3)


def test_odometry_is_of_the_origin() -> None:
    """Thrown without forces, the centre flies straight and the origin circles it."""
    body = plant(
        **{
            **DRAGLESS,
            "airframe__center_of_mass": (0.2, 0.0, 0.0),
            "initial_throttle": 0.0,
            "initial_body_rates": (0.0, 0.0, 2.0),
            "rate_loop__p": (0.0, 0.0, 0.0),
            "rate_loop__d": (0.0, 0.0, 0.0),
            "rate_loop__i": (0.0, 0.0, 0.0),
        }
    )
    assert_allclose(body.odometry(0).p_WB, [0.0, 0.0, 50.0], atol=1e-12)
    assert_allclose(body.odometry(0).v_WB_B, np.zeros(3), atol=1e-12)
    body.advance_to(round(math.pi / 2.0 * 1e9))  # half a turn
    seen = body.odometry(0)
    assert_allclose(seen.p_WB[:2], [0.2 + 0.2, 0.4 * math.pi / 2.0], atol=1e-6)
    assert_allclose(seen.v_WB_B[:2], [0.0, -0.8], atol=1e-6)


def test_flight_does_not_depend_on_how_time_is_divided() -> None:
    whole, split = plant("racer"), plant("racer")
    for body in (whole, split):
        body.apply(command(0.5, (3.0, -2.0, 1.0)))
    whole.advance_to(SECOND // 2)
    for time_ns in (1, 333_333, 12_345_678, 100_000_000, SECOND // 2):
        split.advance_to(time_ns)
    assert_allclose(split.state.p_WB, whole.state.p_WB, atol=1e-9)
    assert_allclose(split.state.R_WB, whole.state.R_WB, atol=1e-9)


def test_flights_repeat_bit_for_bit() -> None:
    noisy = {
        "simulator__gust_intensity": 1.0,
        "simulator__position_noise": 0.01,
        "simulator__battery__capacity": 1.3,
        "simulator__command_delay": 0.013,
    }
    config = vehicle_config("paper", **noisy)
    one, other = (simulate(*config, duration=2.0) for _ in range(2))
    assert_array_equal(one.p_WB, other.p_WB)
    assert one.commands.throttle.tobytes() == other.commands.throttle.tobytes()
    assert one.commands.w_WB_B.tobytes() == other.commands.w_WB_B.tobytes()


def test_refuses_a_motor_count_that_differs_from_the_rotors() -> None:
    with pytest.raises(ConfigurationError, match=r"^simulator\.motor_count: given 6, expected 4"):
        make_plant(configured(motor_count=6))


def test_six_rotors_hover() -> None:
    angles = np.arange(6) * math.pi / 3.0
    six: dict[str, Any] = {
        "motor_count": 6,
        "rotors__x": tuple(0.15 * np.cos(angles)),
        "rotors__y": tuple(0.15 * np.sin(angles)),
        "rotors__spin": (1.0, -1.0) * 3,
        "rotors__z": (0.0,) * 6,
    }
    config = configured(**six)
    body = RotorsPlant(config.updated({"initial_throttle": config.vehicle().hover_throttle}))
    body.advance_to(SECOND)
    assert_allclose(body.state.p_WB, [0.0, 0.0, 50.0], atol=1e-6)


@pytest.mark.parametrize(("linear", "quadratic"), [(0.4, 0.0), (0.0, 0.05)])
def test_terminal_velocity(linear: float, quadratic: float) -> None:
    body = plant(
        **{
            **DRAGLESS,
            "initial_position": (0.0, 0.0, 2000.0),
            "initial_throttle": 0.0,
            "airframe__drag_linear": (0.0, 0.0, linear),
            "airframe__drag_quadratic": (0.0, 0.0, quadratic),
        }
    )
    body.advance_to(30 * SECOND)
    weight = 0.396893 * GRAVITY
    fastest = weight / linear if linear else math.sqrt(weight / quadratic)
    assert_allclose(body.state.v_WB_B, [0.0, 0.0, -fastest], atol=1e-6)


@pytest.mark.parametrize(
    ("scale", "climb"), [({"mass_scale": 1.25}, 1.0 / 1.25 - 1.0), ({"thrust_scale": 0.7}, -0.3)]
)
def test_mass_and_thrust_that_differ_make_it_sink(scale: dict[str, float], climb: float) -> None:
    body = plant(**DRAGLESS, **scale, initial_throttle=configured().vehicle().hover_throttle)
    body.advance_to(SECOND // 2)
    assert body.state.v_WB_W[2] == pytest.approx(0.5 * GRAVITY * climb, rel=1e-6)
