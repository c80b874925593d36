# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Prediction, gate and update of position and velocity and their parameters.

Position, velocity and throttle are predicted with the MPC's model and the estimated parameters,
from the delayed and lagged commands. The attitude rotates at a constant rate between two measured
attitudes. The Jacobian is the forward differences of this prediction.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import kalman, measurement_noise
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.filter_state import (
    DIFFERENCE,
    DRAG_FACTORS,
    LEARNED_STATES,
    LONGEST_THRUST_LAG,
    MAX_THRUST_DELAY,
    MIN_DRAG_MARGIN,
    MOTION,
    SCALE_BOUNDS,
    SHORTEST_THRUST_LAG,
    VERTICAL_BOUND,
    VERTICAL_TIME,
    Filter,
    write_estimated,
)
from quad_mpc_ros.control.estimation.specific_force import force_innovation
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.parameters import modelled_thrust
from quad_mpc_ros.control.model.rollout import Body, StateRecord, propagated
from quad_mpc_ros.control.model.state import U_THROTTLE

_ACCELERATION_NOISE = 0.1  # m/s^2 / sqrt(Hz), process noise of the model
_UNMODELLED_ACCELERATION = 100.0  # m/s^2, if other forces move the vehicle
_BIAS_TIME = 1.0  # s, time constant of the velocity bias
# Drag is observable above this speed across the thrust [m/s], a lag above this change of the
# specific thrust [m/s^2] at rest and per m/s.
_MIN_DRAG_SPEED = 1.0
_MIN_LAG_EFFECT, _MIN_LAG_EFFECT_PER_SPEED = 0.1, 0.05
_MIN_NOISE_AGE = 0.5  # s, after which the noise of the velocity is known


@compiled
def update_translation(
    state: Filter,
    before: StateRecord,
    after: StateRecord,
    acting: Acting,
    mode: UpdateMode,
    reported_variance: float,
) -> UpdateMode:
    """Predict, gate and update; return the mode, which is REJECT if the velocity jumped."""
    x, P, duration = state.translation.x, state.translation.P, acting.durations.sum()
    state.specific_force.used = 0
    if mode == UpdateMode.LEARN and state.specific_force.variance > 0.0:
        _update_by_force(state, before, after, acting)
    was = x.copy()
    F = predict_translation(state, acting, before, after, mode != UpdateMode.HOLD)
    lag_is_observable = _lag_is_observable(state, F, duration)
    _update_noise(state, was, (before, after), mode, duration)
    white = measurement_noise.variance_in(state.velocity_noise)
    drifting = measurement_noise.drift_variance_in(state.drift, reported_variance)
    _add_decay(x, F, mode, duration)
    kalman.predict(P, F, _process_noise(state, white, drifting, duration))
    if mode == UpdateMode.HOLD:
        _add_unmodelled(P, duration)

    H = np.zeros((3, MOTION.size))
    nu = np.empty(3)
    for k in range(3):
        H[k, MOTION.velocity + k] = H[k, MOTION.bias + k] = 1.0
        nu[k] = after.v_WB_W[k] - x[MOTION.velocity + k] - x[MOTION.bias + k]
    innovation = kalman.innovation(P, H, white, nu)
    # A push is not a jump, even if the odometry has little noise.
    margin = max(measurement_noise.USUAL**2 - white, 0.0)
    passed = kalman.squared_distance(innovation, margin) <= kalman.GATE
    if mode != UpdateMode.HOLD and not passed:
        x[:] = was
        restart(state, after.p_WB, after.v_WB_W)
        return UpdateMode.REJECT
    considered = _considered(state, mode, after.R_WB, lag_is_observable)
    kalman.update(x, P, innovation, considered)
    _update_position(state, after.p_WB, considered)
    if mode == UpdateMode.LEARN:
        _constrain_translation(state, considered)
    most = measurement_noise.MOST
    for i in range(MOTION.bias, MOTION.accelerometer):
        x[i] = kernels.clamp(x[i], -most, most)
    return mode


@compiled
def _update_by_force(
    state: Filter, before: StateRecord, after: StateRecord, acting: Acting
) -> None:
    """Correct the estimate at ``before`` with the specific force since then."""
    x, P, duration = state.translation.x, state.translation.P, acting.durations.sum()
    was = x.copy()
    F = predict_translation(state, acting, before, after, True)
    later = x.copy()
    x[:] = was
    lag_is_observable = _lag_is_observable(state, F, duration)
    gravity, between = state.nominal.gravity, (before, after)
    innovation = force_innovation(x, P, F, later, between, duration, gravity, state.specific_force)
    state.specific_force.nis = kalman.squared_distance(innovation, 0.0)
    if not state.specific_force.nis <= kalman.GATE:
        return
    considered = _considered(state, UpdateMode.LEARN, after.R_WB, lag_is_observable)
    kalman.update(x, P, innovation, considered)
    _constrain_translation(state, considered)
    state.specific_force.used = 1


@compiled
def predict_translation(
    state: Filter, acting: Acting, before: StateRecord, after: StateRecord, modelled: bool
) -> Array:
    """Predict the translation, and return the Jacobian (n, n) of the prediction.

    ``before`` and ``after`` are the measured states. Without forces, if not ``modelled``, the
    velocity is constant. Disturbance and bias have 1 on the diagonal.
    """
    x, F, R = state.translation.x, np.eye(MOTION.size), kernels.matrix(before.R_WB)
    turn = kernels.log(kernels.multiply(kernels.transposed(R), kernels.matrix(after.R_WB)))
    w, start = kernels.scaled(1.0 / acting.durations.sum(), turn), x.copy()
    write_estimated(state)
    _propagate(state, acting, R, w, modelled)
    predicted = x.copy()
    for i in range(MOTION.velocity, MOTION.bias):
        x[:] = start
        x[i] += DIFFERENCE
        write_estimated(state)
        _propagate(state, acting, R, w, modelled)
        for k in range(MOTION.bias):
            if k < MOTION.disturbance or k == MOTION.throttle:
                F[k, i] = (x[k] - predicted[k]) / DIFFERENCE
    x[:] = start
    write_estimated(state)
    x[:] = predicted
    return F


@compiled
def _propagate(
    state: Filter, acting: Acting, R: kernels.Matrix, w: kernels.Vector, modelled: bool
) -> None:
    """Propagate position, velocity and throttle from an attitude on, at constant rates."""
    x, model, duration = state.translation.x, state.estimated, acting.durations.sum()
    p, v = x[MOTION.position : MOTION.velocity], x[MOTION.velocity : MOTION.disturbance]
    actuators, none = (x[MOTION.throttle], w[0], w[1], w[2]), (0.0, 0.0, 0.0)
    body = Body(kernels.vector(p), kernels.vector(v), R, actuators, none)
    for n in range(len(acting.durations)):
        command = acting.commands[n, U_THROTTLE], w[0], w[1], w[2]
        body = propagated(model, command, acting.durations[n], body)
    throttle = body.actuators[U_THROTTLE]
    # To first order, the velocity lags by a thrust delay beyond the longest time constant times
    # the change of the thrust.
    late = max(x[MOTION.lag] - model.thrust_time_constant, 0.0)
    change = modelled_thrust(model, throttle) - modelled_thrust(model, x[MOTION.throttle])
    lacking = kernels.scaled(-late * model.thrust_scale * change, kernels.column(body.R, 2))
    for k in range(3):
        p[k] = body.p[k] + 0.5 * duration * lacking[k] if modelled else p[k] + duration * v[k]
        v[k] = body.v[k] + lacking[k] if modelled else v[k]
    x[MOTION.throttle] = throttle


@compiled
def _update_position(state: Filter, measured: Array, considered: Array) -> None:
    """Correct by a measured position (3,); a position that jumped replaces the estimate."""
    x, P, H, nu = state.translation.x, state.translation.P, np.zeros((3, MOTION.size)), np.empty(3)
    for k in range(3):
        H[k, MOTION.position + k] = 1.0
        nu[k] = measured[k] - x[MOTION.position + k]
    variance = measurement_noise.variance_in(state.position_noise)
    innovation = kalman.innovation(P, H, variance, nu)
    state.position_nis = kalman.squared_distance(innovation, 0.0)
    if state.position_nis <= kalman.GATE:
        kalman.update(x, P, innovation, considered)
        return
    state.drift.off[:] = 0.0
    for k in range(3):
        i = MOTION.position + k
        x[i] = measured[k]
        P[i, :] = 0.0
        P[:, i] = 0.0
        P[i, i] = variance


@compiled
def restart(state: Filter, p_WB: Array, v_WB_W: Array) -> None:
    """Start at measured position and velocity (3,), and keep parameters and bias."""
    x, P = state.translation.x, state.translation.P
    for k in range(3):
        p, v, b = MOTION.position + k, MOTION.velocity + k, MOTION.bias + k
        x[p], x[v] = p_WB[k], v_WB_W[k] - x[b]
        P[p, :] = 0.0
        P[:, p] = 0.0
        P[p, p] = measurement_noise.variance_in(state.position_noise)
        # The velocity's error is the negative error of the bias, and noise.
        P[v, :] = -P[b, :]
        P[:, v] = -P[:, b]
        P[v, v] = P[b, b] + measurement_noise.variance_in(state.velocity_noise)


@compiled
def _lag_is_observable(state: Filter, F: Array, duration: float) -> bool:
    """Whether the thrust changes so fast that its time constant is observable in the velocity.

    The throttle, which has the same lag, contributes as well.
    """
    effect, speed, P = 0.0, 0.0, state.translation.P
    if P[MOTION.lag, MOTION.lag] <= 0.0 or state.velocity_noise.age < _MIN_NOISE_AGE:
        return False
    lagged = P[MOTION.throttle, MOTION.lag] / P[MOTION.lag, MOTION.lag]
    for k in range(3):
        i = MOTION.velocity + k
        effect += (F[i, MOTION.lag] + F[i, MOTION.throttle] * lagged) ** 2
        speed += state.translation.x[i] ** 2
    spread = math.sqrt(state.process_noise.translation.P[MOTION.lag, MOTION.lag])
    threshold = _MIN_LAG_EFFECT + _MIN_LAG_EFFECT_PER_SPEED * math.sqrt(speed)
    # The commands respond to noise, which must not look like a response to the commands.
    noise = measurement_noise.variance_in(state.velocity_noise)
    threshold *= max(noise / measurement_noise.USUAL**2, 1.0)
    return spread * math.sqrt(effect) > threshold * duration


@compiled
def _update_noise(
    state: Filter,
    was: Array,
    states: tuple[StateRecord, StateRecord],
    mode: UpdateMode,
    duration: float,
) -> None:
    """Update the noise with two measurements and the prediction from the estimate ``was``."""
    before, after = states
    white = measurement_noise.variance_in(state.position_noise)
    measurement_noise.update_drift(state.drift, after.p_WB, after.v_WB_W, white, duration)
    x = state.translation.x
    of_p = _unpredicted(before.p_WB, after.p_WB, was, x, MOTION.position)
    measurement_noise.update_white_noise(state.position_noise, of_p, duration)
    if mode == UpdateMode.HOLD:
        # Unmodelled forces change the velocity, and positions may be in other units.
        most = max(white, measurement_noise.INITIAL**2)
        state.position_noise.variance = min(state.position_noise.variance, most)
        state.velocity_noise.has_previous = 0
        return
    of_v = _unpredicted(before.v_WB_W, after.v_WB_W, was, x, MOTION.velocity)
    measurement_noise.update_white_noise(state.velocity_noise, of_v, duration)


@compiled
def _unpredicted(
    measured_before: Array, measured: Array, was: Array, x: Array, i: int
) -> kernels.Vector:
    """Return a measured change (3,) minus the predicted change of a block of the state."""
    return (
        measured[0] - measured_before[0] - x[i] + was[i],
        measured[1] - measured_before[1] - x[i + 1] + was[i + 1],
        measured[2] - measured_before[2] - x[i + 2] + was[i + 2],
    )


@compiled
def _add_decay(x: Array, F: Array, mode: UpdateMode, duration: float) -> None:
    """Let bias and vertical disturbance decay, in the estimate and in its Jacobian."""
    kept = math.exp(-duration / _BIAS_TIME)
    for k in range(3):
        x[MOTION.bias + k] *= kept
        F[MOTION.bias + k, MOTION.bias + k] = kept
    if mode == UpdateMode.LEARN:
        vertical = MOTION.disturbance + 2
        kept = math.exp(-duration / VERTICAL_TIME)
        x[vertical] *= kept
        F[vertical, vertical] = kept


@compiled
def _process_noise(state: Filter, white: float, drifting: float, duration: float) -> Array:
    """Return the variances (n,) of the process noise over a duration."""
    P, noise, Q = state.translation.P, state.process_noise.translation, np.zeros(MOTION.size)
    # An accelerometer measures the disturbance independently of the velocity's noise.
    quieter = 1.0 if state.specific_force.used else measurement_noise.USUAL / math.sqrt(white)
    for i in range(LEARNED_STATES[0], LEARNED_STATES[1]):
        if i < MOTION.scale:
            Q[i] = noise.x[i] * quieter * max(quieter, 1.0) * duration
        elif P[i, i] < noise.P[i, i]:  # no less certain than initially
            Q[i] = noise.x[i] * duration
    for k in range(3):
        Q[MOTION.velocity + k] = _ACCELERATION_NOISE**2 * duration
        Q[MOTION.bias + k] = drifting * -math.expm1(-2.0 * duration / _BIAS_TIME)
        i = MOTION.accelerometer + k
        if P[i, i] < noise.P[i, i]:
            Q[i] = noise.x[i] * duration
    return Q


@compiled
def _add_unmodelled(P: Array, duration: float) -> None:
    """Add the variance of an unknown acceleration over a duration."""
    by_p, by_v = 0.5 * duration**2 * _UNMODELLED_ACCELERATION, duration * _UNMODELLED_ACCELERATION
    for k in range(3):
        p, v = MOTION.position + k, MOTION.velocity + k
        P[p, p] += by_p**2
        P[v, v] += by_v**2
        P[p, v] += by_p * by_v
        P[v, p] += by_p * by_v


@compiled
def _considered(state: Filter, mode: UpdateMode, R_WB: Array, lag_is_observable: bool) -> Array:
    """Return which states (n,) are considered, not estimated."""
    considered, x = np.zeros(MOTION.size), state.translation.x
    if mode != UpdateMode.LEARN:
        considered[LEARNED_STATES[0] : LEARNED_STATES[1]] = 1.0
        return considered
    d, v = MOTION.disturbance, kernels.vector(x[MOTION.velocity : MOTION.disturbance])
    # Along the thrust, as in a climb, drag is not distinguished from thrust.
    along = kernels.dot(v, kernels.column(kernels.matrix(R_WB), 2))
    speed = kernels.dot(v, v) - along**2
    at_bound = max(abs(x[d]), abs(x[d + 1])) >= state.bounds.disturbance_max
    considered[MOTION.lag] = not lag_is_observable
    # A disturbance beyond its bound must not be attributed to drag.
    considered[MOTION.drag] = speed <= _MIN_DRAG_SPEED**2 or at_bound
    return considered


@compiled
def _constrain_translation(state: Filter, considered: Array) -> None:
    """Project the parameters into their bounds."""
    x, P, nominal = state.translation.x, state.translation.P, state.nominal
    lag, drag, d = nominal.thrust_time_constant, nominal.drag, MOTION.disturbance
    farthest = state.bounds.disturbance_max
    latest = lag * LONGEST_THRUST_LAG + (MAX_THRUST_DELAY if lag > 0.0 else 0.0)
    least, most = DRAG_FACTORS
    bounds = (
        (d, -farthest, farthest),
        (d + 1, -farthest, farthest),
        (d + 2, -VERTICAL_BOUND, VERTICAL_BOUND),
        (MOTION.drag, least * drag, max(most * drag, drag + MIN_DRAG_MARGIN)),
        (MOTION.lag, lag * SHORTEST_THRUST_LAG, latest),
        (MOTION.scale, SCALE_BOUNDS[0], SCALE_BOUNDS[1]),
    )
    for i, low, high in bounds:
        kalman.constrain(x, P, i, (low, high), considered)
    # A projection may have moved other states beyond their bounds.
    for i, low, high in bounds:
        x[i] = kernels.clamp(x[i], low, high)
