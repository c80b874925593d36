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
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.core import compiled as so3
from quad_mpc_ros.core.compiled import compiled
from quad_mpc_ros.core.messages import Array, OdometrySample
from quad_mpc_ros.core.vehicle import Vehicle

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
RATE = slice(9, 12)
THROTTLE = 12
STATE_SIZE = 13
INPUT_SIZE = 4

SUBSTEPS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbance:
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


def motion_of(odometry: OdometrySample) -> Motion:
    """Return the one state of an odometry whose twist is in the body; its throttle is zero."""
    x = motion(1)
    _read(odometry.p_WB, odometry.q_WB_xyzw, odometry.v_WB_B, odometry.w_WB_B, x)
    return x


@compiled
def _read(p_WB: Array, q_WB_xyzw: Array, v_WB_B: Array, w_WB_B: Array, x: Motion) -> None:
    R = so3.rotation((q_WB_xyzw[0], q_WB_xyzw[1], q_WB_xyzw[2], q_WB_xyzw[3]))
    so3.store_vector(so3.vector(p_WB), x.p_WB[0])
    so3.store_vector(so3.apply(R, so3.vector(v_WB_B)), x.v_WB_W[0])
    so3.store_matrix(R, x.R_WB[0])
    so3.store_vector(so3.vector(w_WB_B), x.actuators[0, 1:])


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


class _Body(NamedTuple):
    """A state as plain numbers."""

    p: so3.Vector
    v: so3.Vector
    R: so3.Matrix
    actuators: Actuators


class _Middle(NamedTuple):
    """A substep half way: mean of the actuators, half of the turn, attitude."""

    mean: Actuators
    half_turn: so3.Vector
    half: so3.Matrix
    R: so3.Matrix


@compiled
def _load(x: Motion, k: int) -> _Body:
    a = x.actuators[k]
    return _Body(
        so3.vector(x.p_WB[k]),
        so3.vector(x.v_WB_W[k]),
        so3.matrix(x.R_WB[k]),
        (a[0], a[1], a[2], a[3]),
    )


@compiled
def _store(body: _Body, x: Motion, k: int) -> None:
    so3.store_vector(body.p, x.p_WB[k])
    so3.store_vector(body.v, x.v_WB_W[k])
    so3.store_matrix(body.R, x.R_WB[k])
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
    d_W: so3.Vector,
    thrust_scale: float,
    command: Actuators,
    x: _Body,
) -> tuple[_Body, _Middle]:
    """Return the state after a substep under a command, and half way."""
    mean = _followed(step.share, x.actuators, command)
    half_turn = so3.scaled(0.5 * step.dt, (mean[1], mean[2], mean[3]))
    half = so3.exp(half_turn)
    R_mid = so3.multiply(x.R, half)
    push = thrust_scale * ((model.a * mean[0] + model.b) * mean[0] + model.c)
    force = so3.plus(so3.scaled(push, so3.column(R_mid, 2)), d_W)
    a = force[0], force[1], force[2] - model.gravity
    after = _Body(
        so3.plus(x.p, so3.plus(so3.scaled(step.phi1, x.v), so3.scaled(step.phi2, a))),
        so3.plus(so3.scaled(step.velocity_decay, x.v), so3.scaled(step.phi1, a)),
        so3.multiply(R_mid, half),
        _followed(step.decay, x.actuators, command),
    )
    return after, _Middle(mean, half_turn, half, R_mid)


@compiled
def advance(
    model: Model,
    a_W: Array,
    thrust_scale: float,
    command: Array,
    duration: float,
    longest: float,
    states: Motion,
) -> None:
    """Move the only one of ``states`` on by ``duration`` [s] under a command (4,).

    In substeps of ``longest`` [s] at most.
    """
    if duration <= 0.0:
        return
    count = max(1, math.ceil(duration / longest - 1e-9))
    step = _discretised(model, duration / count)
    held = (command[0], command[1], command[2], command[3])
    x, d_W = _load(states, 0), so3.vector(a_W)
    for _ in range(count):
        x, _middle = _substep(model, step, d_W, thrust_scale, held, x)
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
    x, d_W = _load(start, 0), so3.vector(a_W)
    _store(x, states, 0)
    for i in range(steps):
        for j in range(substeps):
            command = inputs[i, j, 0], inputs[i, j, 1], inputs[i, j, 2], inputs[i, j, 3]
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
    states: Motion,
    A: Array,
    B: Array,
) -> None:
    """Write A (N, nx, nx) and B (N, nx, 4) of every stage along a rollout.

    ``nx`` is 13, or 9 without what actuators that do not lag need not have. The input of a stage
    moves the commands of all its substeps alike, but for those that are not ``free`` (N, M, 4):
    one, or zero for a command that a bound holds.
    """
    steps, substeps = inputs.shape[:2]
    d = _discretised(model, step / substeps)
    d_W = so3.vector(a_W)
    # Sensitivities of attitude, velocity and position.
    dR, dv, dp = np.empty((_TURNING, 3)), np.empty((_TURNING, 3)), np.empty((_TURNING, 3))
    for i in range(steps):
        x = _load(states, i)
        _begin(dR, dv, dp)
        kept, gained = (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0)
        by_throttle = by_command = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        own_v, own_p = 1.0, 0.0
        for j in range(substeps):
            command = inputs[i, j, 0], inputs[i, j, 1], inputs[i, j, 2], inputs[i, j, 3]
            let = free[i, j, 0], free[i, j, 1], free[i, j, 2], free[i, j, 3]
            x, middle = _substep(model, d, d_W, thrust_scale, command, x)
            mean_kept = _followed(d.share, kept, (0.0, 0.0, 0.0, 0.0))
            mean_gained = _followed(d.share, gained, let)
            _turn_on(model, d, thrust_scale, middle, mean_kept, mean_gained, dR, dv, dp)
            slope = thrust_scale * (2.0 * model.a * middle.mean[0] + model.b)
            push = so3.scaled(slope, so3.column(middle.R, 2))
            by_throttle = _push_on(d, so3.scaled(mean_kept[0], push), by_throttle)
            by_command = _push_on(d, so3.scaled(mean_gained[0], push), by_command)
            kept = _followed(d.decay, kept, (0.0, 0.0, 0.0, 0.0))
            gained = _followed(d.decay, gained, let)
            own_p += d.phi1 * own_v
            own_v *= d.velocity_decay
        _fill(A[i], B[i], own_p, own_v, dR, dv, dp, by_command)
        if A.shape[1] > _WITHOUT_ACTUATORS:
            _fill_actuators(A[i], B[i], kept, gained, dR, dv, dp, by_throttle)


@compiled
def _begin(dR: Array, dv: Array, dp: Array) -> None:
    for n in range(_TURNING):
        for k in range(3):
            dR[n, k] = 1.0 if n == k else 0.0
            dv[n, k] = dp[n, k] = 0.0


@compiled
def _push_on(
    d: _Discretisation, acceleration: so3.Vector, moved: tuple[so3.Vector, so3.Vector]
) -> tuple[so3.Vector, so3.Vector]:
    """Return velocity and position after a substep with an acceleration."""
    v, p = moved
    return (
        so3.plus(so3.scaled(d.velocity_decay, v), so3.scaled(d.phi1, acceleration)),
        so3.plus(p, so3.plus(so3.scaled(d.phi1, v), so3.scaled(d.phi2, acceleration))),
    )


@compiled
def _turn_on(
    model: Model,
    d: _Discretisation,
    thrust_scale: float,
    middle: _Middle,
    mean_kept: Actuators,
    mean_gained: Actuators,
    dR: Array,
    dv: Array,
    dp: Array,
) -> None:
    """Carry the sensitivities to what turns the body, (9, 3) each, over a substep."""
    mean = middle.mean
    push = thrust_scale * ((model.a * mean[0] + model.b) * mean[0] + model.c)
    J = so3.right_jacobian(middle.half_turn)
    x_axis, y_axis = so3.column(middle.R, 0), so3.column(middle.R, 1)
    for n in range(_TURNING):
        # By how much half of the turn moves.
        half = (0.0, 0.0, 0.0)
        if n >= _FROM_COMMAND:
            half = so3.scaled(0.5 * d.dt * mean_gained[n - 5], so3.column(J, n - _FROM_COMMAND))
        elif n >= _FROM_RATE:
            half = so3.scaled(0.5 * d.dt * mean_kept[n - 2], so3.column(J, n - _FROM_RATE))
        turned = so3.plus(so3.apply_transposed(middle.half, so3.vector(dR[n])), half)
        # The thrust's direction moves by R (phi x e3).
        acceleration = so3.scaled(
            push, so3.plus(so3.scaled(turned[1], x_axis), so3.scaled(-turned[0], y_axis))
        )
        v, p = _push_on(d, acceleration, (so3.vector(dv[n]), so3.vector(dp[n])))
        so3.store_vector(v, dv[n])
        so3.store_vector(p, dp[n])
        so3.store_vector(so3.plus(so3.apply_transposed(middle.half, turned), half), dR[n])


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
    by_command: tuple[so3.Vector, so3.Vector],
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
    by_throttle: tuple[so3.Vector, so3.Vector],
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
