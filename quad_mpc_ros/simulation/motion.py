# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The motion of the internal plant at constant command and wind, compiled.

One call advances any number of steps: actuators, equations of motion, ground.

The throttle s follows its command as ds/dt = (s_c - s) / tau; the thrust follows from the curve.
The rate loop of each axis is a proportional gain 1 / tau followed by a torque with lag T, with the
commanded rate w_c

    dw/dt = alpha,    T dalpha/dt = clamp((w_c - w) / tau, -alpha_max, alpha_max) - alpha.

The natural frequency is 1 / sqrt(tau T) and the damping ratio sqrt(tau / T) / 2. A gain D on the
angular acceleration divides tau and T by 1 + D. Without T the rate lags by tau alone, as fast as
alpha_max permits; without tau it is the command.

The controller's model (``control/model/actuators.py``) is implemented independently, so that tests
find errors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.simulation.dynamics import VehicleConstants, integrated
from quad_mpc_ros.simulation.plant import Measured, PlantInputs

AxisState = tuple[float, float]
"""Body rate [rad/s] and angular acceleration [rad/s^2]."""


class BodyRates(NamedTuple):
    """Body rates [rad/s] and angular accelerations [rad/s^2], 0 with a first-order lag."""

    w: kernels.Vector
    acceleration: kernels.Vector


@compiled
def thrust_at(throttle: float, curve: kernels.Vector) -> float:
    """Return the thrust at a throttle, in the units of its curve (highest power first)."""
    return (curve[0] * throttle + curve[1]) * throttle + curve[2]


@compiled
def later_throttle(
    throttle: float, command: float, time_constant: float, duration: float
) -> float:
    """Return the throttle after ``duration`` [s] under one command."""
    kept = math.exp(-duration / time_constant) if time_constant > 0.0 else 0.0
    return command + kept * (throttle - command)


@compiled
def later_rates(
    rates: BodyRates, command: kernels.Vector, vehicle: VehicleConstants, duration: float
) -> tuple[BodyRates, kernels.Matrix]:
    """Return the rates after ``duration`` [s] under one command, and the rotation until then.

    The second term of the Magnus expansion, for rates that change linearly, is their commutator
    times h^2 / 12 (Blanes, Casas, Oteo, Ros, "The Magnus expansion and some of its applications",
    2009). The error is of order h^5.
    """
    (x, alpha_x), turned_x = _axis(rates, command, vehicle, 0, duration)
    (y, alpha_y), turned_y = _axis(rates, command, vehicle, 1, duration)
    (z, alpha_z), turned_z = _axis(rates, command, vehicle, 2, duration)
    after = BodyRates((x, y, z), (alpha_x, alpha_y, alpha_z))
    twist = kernels.scaled(duration * duration / 12.0, kernels.cross(rates.w, after.w))
    return after, kernels.exp(kernels.plus((turned_x, turned_y, turned_z), twist))


@compiled
def _axis(
    rates: BodyRates, command: kernels.Vector, vehicle: VehicleConstants, k: int, duration: float
) -> tuple[AxisState, float]:
    """Return an axis after one step, and the integral of its rate [rad].

    A first-order lag is integrated exactly, others with the Runge-Kutta method of order 4 and the
    cubic through rates and accelerations.
    """
    numbers = (
        vehicle.rate_time_constant[k],
        vehicle.torque_time_constant[k],
        vehicle.angular_acceleration_max[k],
    )
    start, follows, half = (rates.w[k], rates.acceleration[k]), command[k], 0.5 * duration
    if numbers[0] == 0.0 or (numbers[1] == 0.0 and numbers[2] == math.inf):
        off = start[0] - follows
        kept = math.exp(-duration / numbers[0]) if numbers[0] > 0.0 else 0.0
        return (follows + kept * off, 0.0), follows * duration + numbers[0] * (1.0 - kept) * off
    if numbers[1] == 0.0:  # the new command sets the acceleration
        start = start[0], _slope(start, follows, numbers)[0]
    k1 = _slope(start, follows, numbers)
    k2 = _slope(_moved(start, k1, half), follows, numbers)
    k3 = _slope(_moved(start, k2, half), follows, numbers)
    k4 = _slope(_moved(start, k3, duration), follows, numbers)
    end = _moved(_moved(start, k1, duration / 6.0), k2, duration / 3.0)
    end = _moved(_moved(end, k3, duration / 3.0), k4, duration / 6.0)
    if numbers[1] == 0.0:
        end = end[0], _slope(end, follows, numbers)[0]
    turned = half * (start[0] + end[0]) + duration * duration / 12.0 * (start[1] - end[1])
    return end, turned


@compiled
def _slope(x: AxisState, command: float, numbers: kernels.Vector) -> AxisState:
    (w, alpha), (tau, torque_lag, most) = x, numbers
    wanted = kernels.clamp((command - w) / tau, -most, most)
    return (alpha, (wanted - alpha) / torque_lag) if torque_lag > 0.0 else (wanted, 0.0)


@compiled
def _moved(x: AxisState, slope: AxisState, duration: float) -> AxisState:
    return x[0] + duration * slope[0], x[1] + duration * slope[1]


class VehicleState(Record):
    """The state of the vehicle and its actuators."""

    p_WB: Vector3  # m
    v_WB_B: Vector3  # m/s
    R_WB: Matrix3
    throttle: float  # that makes the thrust
    w_WB_B: Vector3  # rad/s
    angular_acceleration: Vector3  # rad/s^2, with a rate loop of second order


@compiled
def advance(
    state: RecordArray[VehicleState],
    inputs: RecordArray[PlantInputs],
    vehicle: RecordArray[VehicleConstants],
    steps: int,
    duration: float,
) -> None:
    """Advance a state by steps of equal ``duration`` [s] under constant inputs."""
    x, u_in, numbers = state[()], inputs[()], vehicle[()]
    gravity, lift = numbers.gravity, kernels.vector(numbers.lift)
    wind_W, command, half = (
        kernels.vector(u_in.wind_W),
        kernels.vector(u_in.w_WB_B),
        0.5 * duration,
    )
    p, v, R = kernels.vector(x.p_WB), kernels.vector(x.v_WB_B), kernels.matrix(x.R_WB)
    rates = BodyRates(kernels.vector(x.w_WB_B), kernels.vector(x.angular_acceleration))
    throttle = x.throttle
    lag = numbers.thrust_time_constant
    if u_in.throttle < throttle:
        lag = numbers.thrust_time_constant_down
    for _ in range(steps):
        start = thrust_at(throttle, lift), rates.w
        throttle = later_throttle(throttle, u_in.throttle, lag, half)
        rates, first_turn = later_rates(rates, command, numbers, half)
        middle = thrust_at(throttle, lift), rates.w
        throttle = later_throttle(throttle, u_in.throttle, lag, half)
        rates, second_turn = later_rates(rates, command, numbers, half)
        end = thrust_at(throttle, lift), rates.w
        if _on_ground(p, v) and max(start[0], end[0]) <= gravity:
            rates = _held(rates, numbers)  # the ground prevents rotation
            continue
        course = start, middle, end, first_turn, second_turn
        p, v, R = integrated(
            p, v, R, course=course, vehicle=numbers, wind_W=wind_W, duration=duration
        )
        if not (p[2] > 0.0 or (p[2] == 0.0 and kernels.apply(R, v)[2] > 0.0)):
            p, v, R = _landed(p, R)
            rates = _held(rates, numbers)
    kernels.store_vector(p, x.p_WB)
    kernels.store_vector(v, x.v_WB_B)
    kernels.store_matrix(R, x.R_WB)
    x.throttle = throttle
    kernels.store_vector(rates.w, x.w_WB_B)
    kernels.store_vector(rates.acceleration, x.angular_acceleration)


@compiled
def measure(state: RecordArray[VehicleState], out: RecordArray[Measured]) -> None:
    """Write the true motion, without rotation on the ground."""
    x, measured = state[()], out[()]
    p, v = kernels.vector(x.p_WB), kernels.vector(x.v_WB_B)
    kernels.store_vector(p, measured.p_WB)
    kernels.store_quaternion(kernels.quaternion(kernels.matrix(x.R_WB)), measured.q_WB_xyzw)
    kernels.store_vector(v, measured.v_WB_B)
    w = (0.0, 0.0, 0.0) if _on_ground(p, v) else kernels.vector(x.w_WB_B)
    kernels.store_vector(w, measured.w_WB_B)


@compiled
def _held(rates: BodyRates, vehicle: VehicleConstants) -> BodyRates:
    """Return the rates of a body on the ground, where rates with a lag are reset to zero."""
    (x, y, z), lags = rates.w, vehicle.rate_time_constant
    held = 0.0 if lags[0] > 0.0 else x, 0.0 if lags[1] > 0.0 else y, 0.0 if lags[2] > 0.0 else z
    return BodyRates(held, (0.0, 0.0, 0.0))


@compiled
def _landed(
    p_WB: kernels.Vector, R_WB: kernels.Matrix
) -> tuple[kernels.Vector, kernels.Vector, kernels.Matrix]:
    """Return the state after a touchdown: at rest, level, same heading."""
    cosine, sine, _ = kernels.column(R_WB, 0)
    return (
        (p_WB[0], p_WB[1], 0.0),
        (0.0, 0.0, 0.0),
        kernels.exp((0.0, 0.0, math.atan2(sine, cosine))),
    )


@compiled
def _on_ground(p_WB: kernels.Vector, v_WB_B: kernels.Vector) -> bool:
    """Whether the vehicle is at rest on the ground."""
    return p_WB[2] <= 0.0 and v_WB_B[0] == 0.0 and v_WB_B[1] == 0.0 and v_WB_B[2] == 0.0
