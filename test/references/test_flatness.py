# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Differential flatness: its states and inputs fly the path through the true dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from fixtures.plant_motion import integrate
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.references.flatness import FlatInputs, flat_inputs

GRAVITY = 9.81
STILL = np.zeros((1, 3))


def strong(path: Path) -> Vehicle:
    """Return a vehicle that lacks no thrust."""
    return Vehicle(
        drag=path.drag,
        rotor_drag=path.rotors,
        thrust_curve=(20.0, 10.0, -5.0),  # some lift is more than the path needs
        gravity=GRAVITY,
    )


@dataclass(frozen=True, kw_only=True)
class Path:
    """Sinusoids of time; ``derivative(n, t)`` (k, 3) of position at times (k,)."""

    amplitude: Array
    frequency: Array
    phase: Array
    yaw: float
    yaw_rate: float
    drag: PerAxis
    rotors: PerAxis = 0.0

    def derivative(self, order: int, times: Array) -> Array:
        angle = np.outer(times, self.frequency) + self.phase + 0.5 * np.pi * order
        return np.asarray(self.amplitude * self.frequency**order * np.sin(angle))

    def inputs(self, times: Array) -> FlatInputs:
        return flat_inputs(
            v_WB_W=self.derivative(1, times),
            a_WB_W=self.derivative(2, times),
            j_WB_W=self.derivative(3, times),
            yaw=self.yaw + self.yaw_rate * times,
            yaw_rate=self.yaw_rate,
            gravity=GRAVITY,
            drag=self.drag,
            rotor_drag=self.rotors,
        )


def miss(path: Path, *, duration: float, step: float) -> float:
    """Return how far [m] the path is missed when its inputs are flown open loop from its start."""
    vehicle = strong(path)
    starts = step * np.arange(round(duration / step) + 1)
    start, middle = path.inputs(starts[:1]), path.inputs(starts[:-1] + 0.5 * step)
    R_WB = start.R_WB[0]
    x = State(
        p_WB=path.derivative(0, starts[:1])[0],
        v_WB_B=R_WB.T @ path.derivative(1, starts[:1])[0],
        R_WB=R_WB,
    )
    farthest = 0.0
    wanted = path.derivative(0, starts[1:])
    for p, thrust, rates in zip(wanted, middle.specific_thrust, middle.w_WB_B, strict=True):
        u = Input(throttle=vehicle.throttle_for(vehicle.mass * float(thrust)), w_WB_B=rates)
        x = integrate(x, u, vehicle, duration=step)
        farthest = max(farthest, float(np.linalg.norm(x.p_WB - p)))
    return farthest


upright = st.builds(
    lambda ax, ay, az, wx, wy, wz, phase, yaw, yaw_rate, drag, rotors: Path(
        amplitude=np.array([ax, ay, az]),
        frequency=np.array([wx, wy, wz]),
        phase=np.array([0.0, phase, -phase]),
        yaw=yaw,
        yaw_rate=yaw_rate,
        drag=drag,
        rotors=rotors,
    ),
    *[st.floats(0.0, 4.0)] * 2,
    st.floats(0.0, 0.8),
    *[st.floats(0.1, 3.0)] * 2,
    st.floats(0.1, 2.5),
    st.floats(-np.pi, np.pi),
    st.floats(-np.pi, np.pi),
    st.floats(-2.0, 2.0),
    # Up to 12 m/s; faster, such drag can leave no thrust, or no attitude.
    st.floats(0.0, 1.0) | st.tuples(st.floats(0.0, 0.4), st.floats(0.0, 0.4), st.floats(0.0, 0.4)),
    st.just(0.0)
    | st.floats(0.0, 0.5)
    | st.tuples(st.floats(0.0, 0.4), st.floats(0.0, 0.4), st.floats(0.0, 0.2)),
)

# Upwards it accelerates by up to twice gravity downwards, so that the thrust points down there,
# 0.4 rad from where yaw is lost.
INVERTED = Path(
    amplitude=np.array([1.5, 0.3, 1.5]),
    frequency=np.array([3.6, 3.6, 3.6]),
    phase=np.array([0.0, np.pi / 2.0, np.pi / 2.0]),
    yaw=0.4,
    yaw_rate=0.3,
    drag=0.2,
)


def test_flown_open_loop_through_inverted_flight() -> None:
    up = INVERTED.inputs(np.linspace(0.0, 2.0, 400)).R_WB[:, 2, 2]
    assert up.min() < -0.9
    assert miss(INVERTED, duration=2.0, step=0.001) < 0.01


def finite_difference_rates(attitude: Callable[[Array], Array], times: Array) -> Array:
    """Return body rates from nothing but attitudes."""
    h = 1e-4
    before, after = attitude(times - h), attitude(times + h)
    return so3.log(np.swapaxes(before, -1, -2) @ after) / (2.0 * h)


@settings(deadline=None)
@given(upright)
def test_rates_are_the_derivative_of_the_attitude(path: Path) -> None:
    times = np.linspace(0.0, 3.0, 40)
    rates = path.inputs(times).w_WB_B
    found = finite_difference_rates(lambda t: path.inputs(t).R_WB, times)
    assert_allclose(rates, found, atol=1e-4 * (1.0 + np.abs(rates).max()))


@pytest.mark.parametrize(
    ("drag", "rotors", "phase", "yaw"),
    [
        ((0.390625, 0.0, 0.0), (0.375, 0.0, 0.0), 0.0, 0.0),
        ((0.4, 0.0, 0.3), (0.4, 0.0, 0.3), -2.0, -2.6),
    ],
)
def test_finds_the_attitude_for_strongly_anisotropic_drag(
    drag: PerAxis, rotors: PerAxis, phase: float, yaw: float
) -> None:
    path = Path(
        amplitude=np.array([4.0, 0.0, 0.5]),
        frequency=np.array([3.875, 1.0, 2.0]),
        phase=np.array([0.0, phase, -phase]),
        yaw=yaw,
        yaw_rate=1.0,
        drag=drag,
        rotors=rotors,
    )
    assert miss(path, duration=2.0, step=0.002) < 0.02


def test_rejects_drag_without_a_feasible_attitude() -> None:
    with pytest.raises(ValueError, match="the path infeasible"):
        flat_inputs(
            v_WB_W=np.array([[20.0, 15.0, -20.0]]),
            a_WB_W=np.array([[0.0, 0.0, -9.0]]),
            j_WB_W=STILL,
            gravity=GRAVITY,
            drag=(1.0, 0.0, 0.0),
        )


@settings(deadline=None)
@given(upright)
def test_newtons_law_holds_with_a_rotation(path: Path) -> None:
    times = np.linspace(0.0, 3.0, 40)
    inputs = path.inputs(times)
    R_WB = inputs.R_WB
    assert_allclose(np.swapaxes(R_WB, -1, -2) @ R_WB, np.tile(np.eye(3), (40, 1, 1)), atol=1e-12)
    assert_allclose(np.linalg.det(R_WB), np.ones(40))
    force = inputs.specific_thrust[:, None] * R_WB[:, :, 2]
    v_WB_B = np.einsum("nji,nj->ni", R_WB, path.derivative(1, times))
    speed = np.sqrt(inputs.specific_thrust / GRAVITY)[:, None]
    air = -(np.array(per_axis(path.drag)) + speed * per_axis(path.rotors)) * v_WB_B
    outer = np.array([0.0, 0.0, -GRAVITY]) + np.einsum("nij,nj->ni", R_WB, air)
    assert_allclose(force + outer, path.derivative(2, times), atol=1e-10)


def one(*, a: list[float] | None = None, **yaw: float) -> FlatInputs:
    a_WB_W = STILL if a is None else np.array([a])
    return flat_inputs(v_WB_W=STILL, a_WB_W=a_WB_W, j_WB_W=STILL, gravity=GRAVITY, drag=0.2, **yaw)


def test_accelerating_forward_the_nose_is_down() -> None:
    nose = one(a=[3.0, 0.0, 0.0]).R_WB[0, :, 0]
    assert nose[2] < -0.1
    assert nose[0] > 0.9
    assert nose[1] == pytest.approx(0.0)


def test_yaw_of_90_degrees_turns_the_nose_from_east_to_north() -> None:
    assert_allclose(one(yaw=np.pi / 2.0).R_WB[0, :, 0], [0.0, 1.0, 0.0], atol=1e-15)
    assert_allclose(one(yaw_rate=0.7).w_WB_B, [[0.0, 0.0, 0.7]])


@pytest.mark.parametrize("direction", np.linspace(0.0, 2.0 * np.pi, 9))
@pytest.mark.parametrize("distance", [1e-3, 1e-7, 1e-12])
def test_is_accurate_near_downward_thrust(direction: float, distance: float) -> None:
    z = np.array([distance * np.cos(direction), distance * np.sin(direction), -1.0])
    R_WB = one(a=[20.0 * z[0], 20.0 * z[1], 20.0 * z[2] - GRAVITY]).R_WB[0]
    assert_allclose(R_WB.T @ R_WB, np.eye(3), atol=1e-9)
    assert_allclose(R_WB[:, 2], z, atol=1e-6)
    # Shortest from level: about a horizontal axis, by almost half a turn.
    assert so3.log(R_WB)[2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("acceleration", "reason"),
    [
        ([0.0, 0.0, -GRAVITY], "free fall"),
        ([0.0, 0.0, -3.0 * GRAVITY], "downwards"),
        ([np.nan, 0.0, 0.0], "finite"),
        ([np.inf, 0.0, 0.0], "finite"),
    ],
)
def test_refuses_path_without_attitude(acceleration: list[float], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        one(a=acceleration)
