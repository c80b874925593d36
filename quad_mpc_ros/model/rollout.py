"""The model of the future: rollout and exact discrete Jacobians, in compiled loops.

State: position and velocity in the world, attitude R_WB, and the actuators, throttle and body rate
(4,), in the order of the inputs. They follow their commands with a first-order lag,

    dp/dt = v,  dv/dt = g + k (T(s)/m) R_WB e3 - mu v + d,  dR/dt = R [w],
    dw/dt = (w_c - w) / tau_w,  ds/dt = (s_c - s) / tau_s,

and without a time constant they are their commands. Over a substep, under one command, the turn is
the exact integral of the lagging rate, and the thrust is that of the mean throttle along the
attitude half way; drag is exact. The Jacobians are those of this discretisation, exact, with the
right Jacobian of SO(3).

Tangent order of the horizon: position, velocity, attitude, body rate, throttle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model import vehicle as vehicles
from quad_mpc_ros.model.vehicle import Vehicle

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
RATE = slice(9, 12)
THROTTLE = 12
STATE_SIZE = 13
INPUT_SIZE = 4

SUBSTEPS = 4


inverse_throttle_curve = compiled(vehicles.inverse_throttle_curve)
"""That of :mod:`quad_mpc_ros.model.vehicle`, for compiled code."""


class Disturbance(NamedTuple):
    """What the model does not explain: an acceleration (3,) [m/s^2], and the thrust's scale."""

    a_W: Array
    thrust_scale: float


NO_DISTURBANCE = Disturbance(a_W=np.zeros(3), thrust_scale=1.0)


class Model(NamedTuple):
    """Numbers of the equations above; thrust over mass is (a s + b) s + c [m/s^2]."""

    a: float
    b: float
    c: float
    drag: float
    gravity: float
    thrust_time_constant: float
    rate_time_constant: float


class Motion(NamedTuple):
    """States of the vehicle: ``p_WB``, ``v_WB_W`` (n, 3), ``R_WB`` (n, 3, 3), and ``actuators``
    (n, 4), throttle and body rates.
    """

    p_WB: Array
    v_WB_W: Array
    R_WB: Array
    actuators: Array


def model_of(vehicle: Vehicle, *, rate_time_constant: float, thrust_time_constant: float) -> Model:
    """Return the model of a vehicle whose actuators lag by time constants [s], or by none: 0."""
    a, b, c = (vehicle.motor_count * k / vehicle.mass for k in vehicle.thrust_curve)
    return Model(
        a=a,
        b=b,
        c=c,
        drag=vehicle.drag,
        gravity=vehicle.gravity,
        thrust_time_constant=thrust_time_constant,
        rate_time_constant=rate_time_constant,
    )


def motion(count: int) -> Motion:
    """Return room for ``count`` states."""
    return Motion(
        p_WB=np.zeros((count, 3)),
        v_WB_W=np.zeros((count, 3)),
        R_WB=np.zeros((count, 3, 3)),
        actuators=np.zeros((count, INPUT_SIZE)),
    )


@compiled
def read_odometry(p_WB: Array, q_WB_xyzw: Array, v_WB_B: Array, w_WB_B: Array, x: Motion) -> None:
    """Write the one state of an odometry whose twist is in the body, but for its throttle."""
    R = kernels.rotation((q_WB_xyzw[0], q_WB_xyzw[1], q_WB_xyzw[2], q_WB_xyzw[3]))
    kernels.store_vector(kernels.vector(p_WB), x.p_WB[0])
    kernels.store_vector(kernels.apply(R, kernels.vector(v_WB_B)), x.v_WB_W[0])
    kernels.store_matrix(R, x.R_WB[0])
    kernels.store_vector(kernels.vector(w_WB_B), x.actuators[0, 1:])


class _Discretisation(NamedTuple):
    """What a substep of ``dt`` seconds does to what is linear.

    After it an actuator keeps ``decay`` of its distance to the command, ``share`` on the average
    over it; the velocity keeps ``velocity_decay`` and gains ``phi1`` times the acceleration, the
    position ``phi1`` times the velocity and ``phi2`` times the acceleration.
    """

    dt: float
    decay: tuple[float, float, float, float]
    share: tuple[float, float, float, float]
    velocity_decay: float
    phi1: float
    phi2: float


@compiled
def _discretised(model: Model, dt: float) -> _Discretisation:
    x = model.drag * dt
    # Integrals of the velocity's response, by series, for drag may be nothing.
    phi1 = dt * (1.0 - x / 2.0 + x * x / 6.0 - x**3 / 24.0 + x**4 / 120.0)
    phi2 = dt * dt * (0.5 - x / 6.0 + x * x / 24.0 - x**3 / 120.0 + x**4 / 720.0)
    s_decay, s_share = _lag(model.thrust_time_constant, dt)
    w_decay, w_share = _lag(model.rate_time_constant, dt)
    return _Discretisation(
        dt,
        (s_decay, w_decay, w_decay, w_decay),
        (s_share, w_share, w_share, w_share),
        math.exp(-x),
        phi1,
        phi2,
    )


@compiled
def _lag(time_constant: float, dt: float) -> tuple[float, float]:
    """Return exp(-t / tau) after a time, and its mean until then."""
    if time_constant <= 0.0:
        return 0.0, 0.0
    decay = math.exp(-dt / time_constant)
    return decay, time_constant * (1.0 - decay) / dt


Actuators = tuple[float, float, float, float]


class Body(NamedTuple):
    """A state as plain numbers, for compiled code."""

    p: kernels.Vector
    v: kernels.Vector
    R: kernels.Matrix
    actuators: Actuators


class _Middle(NamedTuple):
    """A substep half way: mean of the actuators, the thrust's acceleration, half of the turn as a
    vector and as a rotation, attitude.
    """

    mean: Actuators
    push: float
    half_turn: kernels.Vector
    half: kernels.Matrix
    R: kernels.Matrix


@compiled
def input_at(u: Array) -> Actuators:
    """Return throttle and rates (4,) as plain numbers."""
    return u[0], u[1], u[2], u[3]


@compiled
def _load(x: Motion, k: int) -> Body:
    return Body(
        kernels.vector(x.p_WB[k]),
        kernels.vector(x.v_WB_W[k]),
        kernels.matrix(x.R_WB[k]),
        input_at(x.actuators[k]),
    )


@compiled
def _store(body: Body, x: Motion, k: int) -> None:
    kernels.store_vector(body.p, x.p_WB[k])
    kernels.store_vector(body.v, x.v_WB_W[k])
    kernels.store_matrix(body.R, x.R_WB[k])
    for i in range(4):
        x.actuators[k, i] = body.actuators[i]


@compiled
def _followed(keep: Actuators, x: Actuators, command: Actuators) -> Actuators:
    """Return what is between the actuators and their command."""
    return (
        command[0] + keep[0] * (x[0] - command[0]),
        command[1] + keep[1] * (x[1] - command[1]),
        command[2] + keep[2] * (x[2] - command[2]),
        command[3] + keep[3] * (x[3] - command[3]),
    )


@compiled
def _substep(
    model: Model,
    step: _Discretisation,
    d_W: kernels.Vector,
    thrust_scale: float,
    command: Actuators,
    x: Body,
) -> tuple[Body, _Middle]:
    """Return the state after a substep under a command, and half way."""
    mean = _followed(step.share, x.actuators, command)
    half_turn = kernels.scaled(0.5 * step.dt, (mean[1], mean[2], mean[3]))
    half = kernels.exp(half_turn)
    R_mid = kernels.multiply(x.R, half)
    push = thrust_scale * ((model.a * mean[0] + model.b) * mean[0] + model.c)
    force = kernels.plus(kernels.scaled(push, kernels.column(R_mid, 2)), d_W)
    a = force[0], force[1], force[2] - model.gravity
    after = Body(
        kernels.plus(
            x.p, kernels.plus(kernels.scaled(step.phi1, x.v), kernels.scaled(step.phi2, a))
        ),
        kernels.plus(kernels.scaled(step.velocity_decay, x.v), kernels.scaled(step.phi1, a)),
        kernels.multiply(R_mid, half),
        _followed(step.decay, x.actuators, command),
    )
    return after, _Middle(mean, push, half_turn, half, R_mid)


@compiled
def moved_on(
    model: Model,
    d_W: kernels.Vector,
    thrust_scale: float,
    command: Actuators,
    duration: float,
    longest: float,
    x: Body,
) -> Body:
    """Return a state after a duration under a command, in substeps of ``longest`` [s] at most."""
    count = max(1, math.ceil(duration / longest - 1e-9))
    step = _discretised(model, duration / count)
    for _ in range(count):
        x, _middle = _substep(model, step, d_W, thrust_scale, command, x)
    return x


@compiled
def advance(
    model: Model,
    a_W: Array,
    thrust_scale: float,
    commands: Array,
    durations: Array,
    longest: float,
    states: Motion,
) -> None:
    """Move the only one of ``states`` on under commands (n, 4), each for a duration (n,) [s].

    In substeps of ``longest`` [s] at most.
    """
    x, d_W = _load(states, 0), kernels.vector(a_W)
    for k in range(len(durations)):
        command = input_at(commands[k])
        x = moved_on(model, d_W, thrust_scale, command, durations[k], longest, x)
    _store(x, states, 0)


@compiled
def roll_out(
    model: Model,
    step: float,
    a_W: Array,
    thrust_scale: float,
    inputs: Array,
    start: Motion,
    states: Motion,
) -> None:
    """Write the states 0 to N of stages of ``step`` seconds from the only one of ``start`` on.

    ``inputs`` (N, M, 4) are held over a substep each.
    """
    steps, substeps = inputs.shape[:2]
    discretisation = _discretised(model, step / substeps)
    x, d_W = _load(start, 0), kernels.vector(a_W)
    _store(x, states, 0)
    for i in range(steps):
        for j in range(substeps):
            command = input_at(inputs[i, j])
            x, _middle = _substep(model, discretisation, d_W, thrust_scale, command, x)
        _store(x, states, i + 1)


# Columns of the sensitivities to what turns the body: attitude, rates, commanded rates.
_FROM_RATE, _FROM_COMMAND, _TURNING = 3, 6, 9


@compiled
def jacobians(
    model: Model,
    step: float,
    a_W: Array,
    thrust_scale: float,
    inputs: Array,
    free: Array,
    start: Motion,
    states: Motion,
    A: Array,
    B: Array,
) -> None:
    """Roll out as :func:`roll_out` does, and write A (N, nx, nx) and B (N, nx, 4) on the way.

    ``nx`` is 13, or 9 without what actuators that do not lag need not have. The input of a stage
    moves the commands of all its substeps alike, but for those that are not ``free`` (N, M, 4):
    one, or zero for a command that a bound holds.
    """
    steps, substeps = inputs.shape[:2]
    lagging = A.shape[1] > _WITHOUT_ACTUATORS
    d = _discretised(model, step / substeps)
    x, d_W = _load(start, 0), kernels.vector(a_W)
    _store(x, states, 0)
    # Sensitivities of attitude, velocity and position.
    dR, dv, dp = np.empty((_TURNING, 3)), np.empty((_TURNING, 3)), np.empty((_TURNING, 3))
    for i in range(steps):
        _begin(dR, dv, dp)
        kept, gained = (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0)
        by_throttle = by_command = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        own_v, own_p = 1.0, 0.0
        for j in range(substeps):
            command, let = input_at(inputs[i, j]), input_at(free[i, j])
            x, middle = _substep(model, d, d_W, thrust_scale, command, x)
            mean_kept = _followed(d.share, kept, (0.0, 0.0, 0.0, 0.0))
            mean_gained = _followed(d.share, gained, let)
            _turn_on(d, middle, mean_kept, mean_gained, lagging, dR, dv, dp)
            slope = thrust_scale * (2.0 * model.a * middle.mean[0] + model.b)
            push = kernels.scaled(slope, kernels.column(middle.R, 2))
            by_throttle = _push_on(d, kernels.scaled(mean_kept[0], push), by_throttle)
            by_command = _push_on(d, kernels.scaled(mean_gained[0], push), by_command)
            kept = _followed(d.decay, kept, (0.0, 0.0, 0.0, 0.0))
            gained = _followed(d.decay, gained, let)
            own_p += d.phi1 * own_v
            own_v *= d.velocity_decay
        _store(x, states, i + 1)
        _fill(A[i], B[i], own_p, own_v, dR, dv, dp, by_command)
        if lagging:
            _fill_actuators(A[i], B[i], kept, gained, dR, dv, dp, by_throttle)


@compiled
def _begin(dR: Array, dv: Array, dp: Array) -> None:
    for n in range(_TURNING):
        for k in range(3):
            dR[n, k] = 1.0 if n == k else 0.0
            dv[n, k] = dp[n, k] = 0.0


@compiled
def _push_on(
    d: _Discretisation, acceleration: kernels.Vector, moved: tuple[kernels.Vector, kernels.Vector]
) -> tuple[kernels.Vector, kernels.Vector]:
    """Return velocity and position after a substep with an acceleration."""
    v, p = moved
    return (
        kernels.plus(kernels.scaled(d.velocity_decay, v), kernels.scaled(d.phi1, acceleration)),
        kernels.plus(
            p, kernels.plus(kernels.scaled(d.phi1, v), kernels.scaled(d.phi2, acceleration))
        ),
    )


@compiled
def _turn_on(
    d: _Discretisation,
    middle: _Middle,
    mean_kept: Actuators,
    mean_gained: Actuators,
    lagging: bool,
    dR: Array,
    dv: Array,
    dp: Array,
) -> None:
    """Carry the sensitivities to what turns the body, (9, 3) each, over a substep.

    Those to rates that do not lag are zero.
    """
    J = kernels.right_jacobian(middle.half_turn)
    x_axis, y_axis = kernels.column(middle.R, 0), kernels.column(middle.R, 1)
    for n in range(_TURNING):
        if _FROM_RATE <= n < _FROM_COMMAND and not lagging:
            continue
        # By how much half of the turn moves.
        half = (0.0, 0.0, 0.0)
        if n >= _FROM_COMMAND:
            half = kernels.scaled(
                0.5 * d.dt * mean_gained[n - 5], kernels.column(J, n - _FROM_COMMAND)
            )
        elif n >= _FROM_RATE:
            half = kernels.scaled(0.5 * d.dt * mean_kept[n - 2], kernels.column(J, n - _FROM_RATE))
        turned = kernels.plus(kernels.apply_transposed(middle.half, kernels.vector(dR[n])), half)
        # The thrust's direction moves by R (phi x e3).
        acceleration = kernels.scaled(
            middle.push,
            kernels.plus(kernels.scaled(turned[1], x_axis), kernels.scaled(-turned[0], y_axis)),
        )
        v, p = _push_on(d, acceleration, (kernels.vector(dv[n]), kernels.vector(dp[n])))
        kernels.store_vector(v, dv[n])
        kernels.store_vector(p, dp[n])
        kernels.store_vector(
            kernels.plus(kernels.apply_transposed(middle.half, turned), half), dR[n]
        )


# Entries of the attitude, and of the state without actuators.
_ATTITUDE, _WITHOUT_ACTUATORS = 6, 9


@compiled
def _fill(
    A: Array,
    B: Array,
    own_p: float,
    own_v: float,
    dR: Array,
    dv: Array,
    dp: Array,
    by_command: tuple[kernels.Vector, kernels.Vector],
) -> None:
    """Write what can be other than zero of position, velocity and attitude."""
    for k in range(3):
        A[k, k] = 1.0
        A[k, 3 + k] = own_p
        A[3 + k, 3 + k] = own_v
        B[3 + k, 0], B[k, 0] = by_command[0][k], by_command[1][k]
        for n in range(3):
            A[k, _ATTITUDE + n] = dp[n, k]
            A[3 + k, _ATTITUDE + n] = dv[n, k]
            A[_ATTITUDE + k, _ATTITUDE + n] = dR[n, k]
            B[k, 1 + n] = dp[_FROM_COMMAND + n, k]
            B[3 + k, 1 + n] = dv[_FROM_COMMAND + n, k]
            B[_ATTITUDE + k, 1 + n] = dR[_FROM_COMMAND + n, k]


@compiled
def _fill_actuators(
    A: Array,
    B: Array,
    kept: Actuators,
    gained: Actuators,
    dR: Array,
    dv: Array,
    dp: Array,
    by_throttle: tuple[kernels.Vector, kernels.Vector],
) -> None:
    """Write the columns and rows of body rate and throttle."""
    for k in range(3):
        for n in range(3):
            A[k, 9 + n] = dp[_FROM_RATE + n, k]
            A[3 + k, 9 + n] = dv[_FROM_RATE + n, k]
            A[_ATTITUDE + k, 9 + n] = dR[_FROM_RATE + n, k]
        A[3 + k, 12], A[k, 12] = by_throttle[0][k], by_throttle[1][k]
        A[9 + k, 9 + k], B[9 + k, 1 + k] = kept[1 + k], gained[1 + k]
    A[12, 12], B[12, 0] = kept[0], gained[0]
