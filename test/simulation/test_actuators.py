# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Delay and lags against closed forms and an integrator of another kind."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.internal_plant import InternalPlant

MILLISECOND = 1_000_000
HOVER = Vehicle().hover_throttle


def command(throttle: float, rates: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> CommandSample:
    return CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(rates))


def plant(**changes: Any) -> InternalPlant:
    start = {"initial_position": (0.0, 0.0, 50.0), "initial_throttle": HOVER}
    return InternalPlant(ideal({**start, **changes}))


@dataclass
class World:
    """The vehicle in world coordinates, with a quaternion, integrated by DOP853 to 1e-12."""

    y: Array
    rate_tau: PerAxis = 0.0
    vehicle: Vehicle = dataclasses.field(default_factory=Vehicle)
    thrust_tau: float = 0.0
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def fly(self, throttle: float, rates: tuple[float, float, float], duration: float) -> None:
        target_w, vehicle = np.array(rates), self.vehicle
        drag, rate_tau = np.array(per_axis(vehicle.drag)), np.array(per_axis(self.rate_tau))
        at_once, rotors = rate_tau == 0.0, np.array(per_axis(vehicle.rotor_drag))
        self.y[10:13][at_once] = target_w[at_once]
        if self.thrust_tau == 0.0:
            self.y[13] = throttle

        def derivative(_: float, y: Array) -> Array:
            v, (x, yy, z, w), rate, s = y[3:6], y[6:10], y[10:13], y[13]
            a, b, c = rate
            attitude = Rotation.from_quat([x, yy, z, w])
            up = attitude.apply([0.0, 0.0, 1.0])
            through_air = attitude.inv().apply(v - np.array(self.wind))
            lift = vehicle.translational_lift * (through_air[0] ** 2 + through_air[1] ** 2)
            curve = np.polyval(vehicle.thrust_curve, s)
            turning = np.sqrt(max(4.0 * curve, 0.0) / (vehicle.mass * vehicle.gravity))
            acceleration = (
                (4.0 * curve / vehicle.mass + lift) * up
                - np.array([0.0, 0.0, vehicle.gravity])
                - attitude.apply((drag + turning * rotors) * through_air)
            )
            spin = 0.5 * np.array(
                [
                    w * a + yy * c - z * b,
                    w * b + z * a - x * c,
                    w * c + x * b - yy * a,
                    -x * a - yy * b - z * c,
                ]
            )
            lag_w = (target_w - rate) / np.where(at_once, np.inf, rate_tau)
            lag_s = (throttle - s) / self.thrust_tau if self.thrust_tau else 0.0
            return np.concatenate((v, acceleration, spin, lag_w, [lag_s]))

        self.y = solve_ivp(
            derivative, (0.0, duration), self.y, method="DOP853", rtol=1e-12, atol=1e-13
        ).y[:, -1]


# Throttle, body rates, how long the command acts [ms].
SEQUENCE = [
    (0.7, (12.0, -9.0, 5.0), 70),
    (0.2, (-15.0, 6.0, -4.0), 130),
    (0.9, (3.0, 10.0, 8.0), 50),
    (0.4, (0.0, -18.0, 2.0), 150),
]


def start(**parts: Any) -> World:
    q = Rotation.from_euler("xyz", [0.4, -0.6, 1.9]).as_quat()
    y = np.concatenate(([0.0, 0.0, 50.0, 3.0, -2.0, 1.0], q, [2.0, -1.0, 0.5, HOVER]))
    return World(y, **parts)


def started_plant(**changes: Any) -> InternalPlant:
    y = start().y
    return plant(
        initial_position=tuple(y[:3]),
        initial_velocity=tuple(y[3:6]),
        initial_attitude=tuple(y[6:10]),
        initial_body_rates=tuple(y[10:13]),
        **changes,
    )


def assert_agrees(body: InternalPlant, world: World, *, atol: float) -> None:
    assert_allclose(body.state.p_WB, world.y[:3], rtol=0.0, atol=atol)
    assert_allclose(body.state.v_WB_W, world.y[3:6], rtol=0.0, atol=atol)
    R_WB = Rotation.from_quat(world.y[6:10]).as_matrix()
    assert_allclose(body.state.R_WB, R_WB, rtol=0.0, atol=atol)
    assert_allclose(body.odometry(0).w_WB_B, world.y[10:13], rtol=0.0, atol=atol)
    assert_allclose(body._x["throttle"], world.y[13], rtol=0.0, atol=atol)


@pytest.mark.parametrize(
    ("rate_tau", "thrust_tau"),
    [
        (0.0, 0.0),
        (0.008, 0.2),
        ((0.03, 0.04, 0.1), 0.03),
        ((0.0, 0.05, 0.02), 0.0),
    ],
)
@pytest.mark.parametrize(("step", "atol"), [(0.0005, 1e-8), (0.005, 3e-6)])
def test_lagged_flight_agrees_with_another_integrator(
    rate_tau: PerAxis, thrust_tau: float, step: float, atol: float
) -> None:
    world = start(rate_tau=rate_tau, thrust_tau=thrust_tau)
    body = started_plant(
        rate_time_constant=rate_tau, thrust_time_constant=thrust_tau, integration_step=step
    )
    time_ns = 0
    for throttle, rates, milliseconds in SEQUENCE:
        body.apply(command(throttle, rates))
        time_ns += milliseconds * MILLISECOND
        body.advance_to(time_ns)
        world.fly(throttle, rates, milliseconds * 1e-3)
        assert_agrees(body, world, atol=atol)


def test_lags_delay_drag_and_wind_together_agree_with_another_integrator() -> None:
    """Commands of a 20 ms cycle act 23.4 ms later, between two cycles."""
    air: dict[str, Any] = {
        "drag": (0.3, 0.1, 0.6),
        "rotor_drag": (0.4, 0.2, 0.1),
        "translational_lift": 0.02,
    }
    world = start(rate_tau=0.03, thrust_tau=0.04, vehicle=Vehicle(**air))
    world.wind = (5.0, -2.0, 1.0)
    body = started_plant(
        rate_time_constant=0.03,
        thrust_time_constant=0.04,
        command_delay=0.0234,
        wind=world.wind,
        integration_step=0.0005,
        **air,
    )
    sent = [(0.3 + 0.05 * k, (10.0 * math.sin(k), -6.0, 2.0 * k)) for k in range(10)]
    for k, (throttle, rates) in enumerate(sent):
        body.advance_to(20 * k * MILLISECOND)
        body.apply(command(throttle, rates))
    body.advance_to(210 * MILLISECOND)

    world.fly(HOVER, (2.0, -1.0, 0.5), 0.0234)
    for throttle, rates in sent[:9]:
        world.fly(throttle, rates, 0.020)
    world.fly(*sent[9], 0.210 - 0.0234 - 9 * 0.020)
    assert_agrees(body, world, atol=1e-8)


@pytest.mark.parametrize("delay_ns", [1, 12_345_678, 20 * MILLISECOND, 57 * MILLISECOND])
def test_commands_act_exactly_their_delay_later(delay_ns: int) -> None:
    body = plant(command_delay=delay_ns * 1e-9)
    sent_ns = [20 * k * MILLISECOND for k in range(8)]
    events = [(time_ns, "send", k) for k, time_ns in enumerate(sent_ns, start=1)]
    events += [(time_ns + delay_ns - 1, "before", k) for k, time_ns in enumerate(sent_ns, start=1)]
    events += [(time_ns + delay_ns, "acts", k) for k, time_ns in enumerate(sent_ns, start=1)]
    for time_ns, event, k in sorted(events):
        body.advance_to(time_ns)
        if event == "send":
            body.apply(command(0.4, (0.1 * k, 0.0, 0.0)))
        else:
            assert body.odometry(0).w_WB_B[0] == 0.1 * (k if event == "acts" else k - 1)


def test_on_the_ground_rotors_spin_up_without_rotation() -> None:
    body = InternalPlant(ideal(thrust_time_constant=0.1, rate_time_constant=0.1))
    body.apply(command(0.5, (3.0, 0.0, 0.0)))
    lifts_after = -0.1 * math.log(1.0 - HOVER / 0.5)
    body.advance_to(round(lifts_after * 1e9) - 6 * MILLISECOND)
    assert_array_equal(body.state.R_WB, np.eye(3))
    assert_array_equal(body.odometry(0).w_WB_B, np.zeros(3))
    assert 0.0 < body._x["throttle"] < HOVER
    body.advance_to(round(lifts_after * 1e9) + 20 * MILLISECOND)
    assert body.state.p_WB[2] > 0.0
    assert 0.0 < body.odometry(0).w_WB_B[0] < 3.0


def test_flight_does_not_depend_on_how_time_is_divided() -> None:
    effects = {"rate_time_constant": 0.02, "thrust_time_constant": 0.05, "command_delay": 0.0123}
    whole, divided = plant(**effects), plant(**effects)
    for body in (whole, divided):
        body.apply(command(0.5, (5.0, -3.0, 2.0)))
    whole.advance_to(200 * MILLISECOND)
    for time_ns in np.random.default_rng(0).integers(0, 200 * MILLISECOND, 50):
        divided.advance_to(int(time_ns))
    for time_ns in range(0, 200 * MILLISECOND + 1, 2 * MILLISECOND):
        divided.advance_to(time_ns)
    assert_allclose(whole.state.p_WB, divided.state.p_WB, atol=1e-7)
    assert_allclose(whole.state.R_WB, divided.state.R_WB, atol=1e-6)
    assert_allclose(whole.odometry(0).w_WB_B, divided.odometry(0).w_WB_B, rtol=1e-12)
