# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The prediction model, rolled out in compiled loops.

State: position and velocity in the world, attitude R_WB, and the actuators, throttle and body rate
(4,), in the order of the inputs, and angular acceleration. The throttle follows its command with a
first-order lag (:mod:`quad_mpc_ros.control.model.actuators`), the rates follow with a lag of
second order (:mod:`quad_mpc_ros.control.model.actuators`),

    dp/dt = v,  dv/dt = g + k (T(s)/m) R_WB e3 - R D R' v + k_h (u_x^2 + u_y^2) R e3 + d,
    dR/dt = R [w],  dw/dt = alpha,  T dalpha/dt = (w_c - w) / tau_w - alpha,
    ds/dt = (s_c - s) / tau_s,

with u = R' v; a tau_s that may differ between rise and fall; a bound on the demanded acceleration
(w_c - w) / tau_w; a drag D = diag(mu + nu sqrt(k T(s) / m g)), with three mu of the body and three
nu of the rotors, proportional to their speed (Svacha, Mohta, Kumar, "Improving quadrotor
trajectory tracking by compensating for aerodynamic effects", ICUAS 2017); the thrust k_h gained by
flying across the rotors (Faessler, Franchi, Scaramuzza, "Differential flatness of quadrotor
dynamics subject to rotor drag", RA-L 2018); and a tau_w and T for each axis, as yaw is often
several times slower.

The simulated plant (:mod:`quad_mpc_ros.simulation.dynamics`) implements the equations
independently, so that flights reveal errors.

Over a substep, under one command, the rotation is the exact integral of the lagging rate, and the
thrust follows from the mean throttle, along the midpoint attitude. The drag's mean over the axes
is integrated exactly; anisotropic drag, rotor drag and lift are evaluated at the midpoint.

In memory a state is a :class:`StateRecord`, in registers a :class:`Body`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import (
    Actuators,
    AxisStep,
    LoopResponse,
    actuators_in,
    axis_step,
    first_order_lag,
    loop_step,
)
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.state import U_RATE, U_THROTTLE

SUBSTEPS = 4
_LONGEST_SUBSTEP = 0.005  # s, of predictions; the error is of third order in the rotation


class StateRecord(Record):
    """A state in memory."""

    p_WB: Vector3  # m
    v_WB_W: Vector3  # m/s
    R_WB: Matrix3
    throttle: float
    w_WB_B: Vector3  # rad/s
    angular_acceleration: Vector3  # rad/s^2, 0 if the torque does not lag


class Body(NamedTuple):
    """A state as plain numbers, for compiled code."""

    p: kernels.Vector
    v: kernels.Vector
    R: kernels.Matrix
    actuators: Actuators
    acceleration: kernels.Vector


@compiled
def body_in(state: StateRecord) -> Body:
    """Return a state in memory as plain numbers."""
    w = state.w_WB_B
    return Body(
        kernels.vector(state.p_WB),
        kernels.vector(state.v_WB_W),
        kernels.matrix(state.R_WB),
        (state.throttle, w[0], w[1], w[2]),
        kernels.vector(state.angular_acceleration),
    )


@compiled
def store_body(body: Body, state: StateRecord) -> None:
    """Write a state into memory."""
    throttle, roll, pitch, yaw = body.actuators
    kernels.store_vector(body.p, state.p_WB)
    kernels.store_vector(body.v, state.v_WB_W)
    kernels.store_matrix(body.R, state.R_WB)
    kernels.store_vector((roll, pitch, yaw), state.w_WB_B)
    kernels.store_vector(body.acceleration, state.angular_acceleration)
    state.throttle = throttle


@compiled
def read_odometry(
    p_WB: Array, q_WB_xyzw: Array, v_WB_B: Array, w_WB_B: Array, state: StateRecord
) -> None:
    """Write the state of an odometry with the twist in the body.

    Throttle and angular acceleration are not measured and do not change.
    """
    R = kernels.rotation(kernels.quaternion_in(q_WB_xyzw))
    kernels.store_vector(kernels.vector(p_WB), state.p_WB)
    kernels.store_vector(kernels.apply(R, kernels.vector(v_WB_B)), state.v_WB_W)
    kernels.store_matrix(R, state.R_WB)
    kernels.store_vector(kernels.vector(w_WB_B), state.w_WB_B)


class Discretisation(NamedTuple):
    """Coefficients of the linear part of a substep of ``dt`` seconds.

    ``thrust`` and ``thrust_down`` are the remaining distances of the throttle to its command, at
    the end and on average, while it rises and falls, ``loops`` the responses of the rates. The
    velocity is multiplied by ``velocity_decay`` and gains ``phi1`` times the acceleration; the
    position gains ``phi1`` times the velocity and ``phi2`` times the acceleration.
    ``anisotropic``: anisotropic drag, rotor drag or lift is present.
    """

    dt: float
    thrust: tuple[float, float]
    thrust_down: tuple[float, float]
    loops: tuple[LoopResponse, LoopResponse, LoopResponse]
    velocity_decay: float
    phi1: float
    phi2: float
    anisotropic: bool


@compiled
def discretised(model: ModelParameters, dt: float) -> Discretisation:
    """Return the coefficients of a substep of ``dt`` seconds."""
    x = model.drag * dt
    # Integrals of the velocity's response as series, as the drag may be 0.
    phi1 = dt * (1.0 - x / 2.0 + x * x / 6.0 - x**3 / 24.0 + x**4 / 120.0)
    phi2 = dt * dt * (0.5 - x / 6.0 + x * x / 24.0 - x**3 / 120.0 + x**4 / 720.0)
    return Discretisation(
        dt,
        first_order_lag(model.thrust_time_constant, dt),
        first_order_lag(model.thrust_time_constant_down, dt),
        (_loop_step(model, 0, dt), _loop_step(model, 1, dt), _loop_step(model, 2, dt)),
        math.exp(-x),
        phi1,
        phi2,
        is_anisotropic(model),
    )


@compiled
def _loop_step(model: ModelParameters, axis: int, dt: float) -> LoopResponse:
    return loop_step(
        model.rate_time_constants[axis],
        model.torque_time_constants[axis],
        model.angular_acceleration_max[axis],
        dt,
    )


@compiled
def is_anisotropic(model: ModelParameters) -> bool:
    """Whether there is anisotropic drag, rotor drag or translational lift."""
    alike = kernels.is_zero(model.anisotropic_drag) and kernels.is_zero(model.rotor_drag)
    return bool(not alike or model.translational_lift != 0.0)


@compiled
def rotor_speed(model: ModelParameters, specific_thrust: float) -> float:
    """Return the rotor speed relative to hover, from the specific thrust [m/s^2]."""
    return math.sqrt(max(specific_thrust, 0.0) / model.gravity)


@compiled
def anisotropic_air(model: ModelParameters, u: kernels.Vector, speed: float) -> kernels.Vector:
    """Return the acceleration by anisotropic drag and lift at a velocity ``u``, in the body.

    ``speed`` is the rotor speed relative to hover.
    """
    drag, rotors = model.anisotropic_drag, model.rotor_drag
    d = drag[0] + speed * rotors[0], drag[1] + speed * rotors[1], drag[2] + speed * rotors[2]
    lift = model.translational_lift * (u[0] * u[0] + u[1] * u[1])
    return -d[0] * u[0], -d[1] * u[1], lift - d[2] * u[2]


class Midpoint(NamedTuple):
    """Midpoint of a substep, for the Jacobians: mean throttle with the applied lag, steps of the
    rates, specific thrust, half of the rotation as vector and matrix, and attitude.
    """

    throttle: float
    lag: tuple[float, float]
    axes: tuple[AxisStep, AxisStep, AxisStep]
    specific_thrust: float
    half_turn: kernels.Vector
    half: kernels.Matrix
    R: kernels.Matrix


@compiled
def substep(
    model: ModelParameters, step: Discretisation, command: Actuators, x: Body
) -> tuple[Body, Midpoint]:
    """Return the state after a substep under a command, and the midpoint."""
    roll, pitch, yaw = (
        _axis_step(step, x, command, 0),
        _axis_step(step, x, command, 1),
        _axis_step(step, x, command, 2),
    )
    off = x.actuators[U_THROTTLE] - command[U_THROTTLE]
    lag = step.thrust_down if off > 0.0 else step.thrust
    throttle = command[U_THROTTLE] + lag[1] * off
    half_turn = kernels.scaled(0.5 * step.dt, (roll.mean, pitch.mean, yaw.mean))
    half = kernels.exp(half_turn)
    R_mid = kernels.multiply(x.R, half)
    thrust = model.thrust_scale * ((model.a * throttle + model.b) * throttle + model.c)
    force = kernels.plus(
        kernels.scaled(thrust, kernels.column(R_mid, 2)), kernels.vector(model.a_W)
    )
    a = force[0], force[1], force[2] - model.gravity
    if step.anisotropic:
        slowed = kernels.plus(a, kernels.scaled(-model.drag, x.v))
        v_B = kernels.apply_transposed(
            R_mid, kernels.plus(x.v, kernels.scaled(0.5 * step.dt, slowed))
        )
        a = kernels.plus(
            a, kernels.apply(R_mid, anisotropic_air(model, v_B, rotor_speed(model, thrust)))
        )
    after = Body(
        kernels.plus(
            x.p, kernels.plus(kernels.scaled(step.phi1, x.v), kernels.scaled(step.phi2, a))
        ),
        kernels.plus(kernels.scaled(step.velocity_decay, x.v), kernels.scaled(step.phi1, a)),
        kernels.multiply(R_mid, half),
        (command[U_THROTTLE] + lag[0] * off, roll.rate, pitch.rate, yaw.rate),
        (roll.acceleration, pitch.acceleration, yaw.acceleration),
    )
    axes = roll, pitch, yaw
    return after, Midpoint(throttle, lag, axes, thrust, half_turn, half, R_mid)


@compiled
def _axis_step(step: Discretisation, x: Body, command: Actuators, axis: int) -> AxisStep:
    rate = U_RATE + axis
    return axis_step(step.loops[axis], x.actuators[rate], x.acceleration[axis], command[rate])


@compiled
def propagated(model: ModelParameters, command: Actuators, duration: float, x: Body) -> Body:
    """Return a state after a duration [s] under a command."""
    count = max(1, math.ceil(duration / _LONGEST_SUBSTEP - 1e-9))
    step = discretised(model, duration / count)
    for _ in range(count):
        x, _midpoint = substep(model, step, command, x)
    return x


@compiled
def roll_forward(
    model: ModelParameters,
    commands: Array,
    durations: Array,
    start: StateRecord,
    end: StateRecord,
) -> None:
    """Write the state after commands (n, 4), each held for a duration (n,) [s].

    ``start`` and ``end`` may be one array.
    """
    x = body_in(start)
    for k in range(len(durations)):
        x = propagated(model, actuators_in(commands[k]), durations[k], x)
    store_body(x, end)


@compiled
def roll_out(
    model: ModelParameters,
    step: float,
    inputs: Array,
    start: StateRecord,
    states: RecordArray[StateRecord],
) -> None:
    """Write the states 0 to N (N + 1,) of stages of ``step`` seconds from ``start`` on.

    ``inputs`` (N, M, 4) are held over a substep each.
    """
    steps, substeps = inputs.shape[:2]
    discretisation = discretised(model, step / substeps)
    x = body_in(start)
    store_body(x, states[0])
    for i in range(steps):
        for j in range(substeps):
            x, _midpoint = substep(model, discretisation, actuators_in(inputs[i, j]), x)
        store_body(x, states[i + 1])
