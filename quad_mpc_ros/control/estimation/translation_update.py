"""Predict, gate and update the motion, and what is learned by it."""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import error_state, kalman, measurement_noise
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.error_state import (
    LEARNED_STATES,
    MOTION,
    SCALE_BOUNDS,
    VERTICAL_BOUND,
)
from quad_mpc_ros.control.estimation.filter_state import Filter, write_estimated
from quad_mpc_ros.control.estimation.process_model import predict_translation, predict_unmodelled
from quad_mpc_ros.control.estimation.specific_force import force_innovation
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import StateRecord

_ACCELERATION_NOISE = 0.1  # m/s^2 / sqrt(Hz), of the model within a step
_UNMODELLED = 100.0  # m/s^2, of a vehicle that something else moves
_BIAS_TIME = 1.0  # s, for which an error of the velocity lasts
# Drag is distinguished from wind above this speed across the thrust [m/s], a lag where thrust
# changes by so much [m/s^2], at rest and per m/s.
_OBSERVABLE_SPEED = 1.0
_HIDDEN, _HIDDEN_BY_SPEED = 0.05, 0.05


@compiled
def update_translation(
    state: Filter,
    before: StateRecord,
    after: StateRecord,
    acting: Acting,
    mode: UpdateMode,
    given_variance: float,
) -> UpdateMode:
    """Predict, gate and update the motion; return the mode, which may now be that of a jump."""
    x, P, duration = state.translation.x, state.translation.P, acting.durations.sum()
    F, lag_shows = np.empty((MOTION.size, MOTION.size)), False
    state.specific_force.used = 0
    if mode == UpdateMode.LEARN and state.specific_force.variance > 0.0:
        _update_by_force(state, before, after, acting, F)
    was = x.copy()
    if mode == UpdateMode.HOLD:
        predict_unmodelled(state.estimated, state.translation, acting, F)
    else:
        predict_translation(
            state.estimated, state.drag_shape, state.translation, acting, before, after, F
        )
        lag_shows = _lag_shows(state, F, duration)
    _follow_noise(state, was, (before, after), mode, duration)
    white = measurement_noise.variance_in(state.velocity_noise)
    drifting = measurement_noise.drift_variance_in(state.drift, given_variance)
    _add_memory(x, F, mode, duration)
    kalman.predict(P, F, _motion_noise(state, white, drifting, duration))
    if mode == UpdateMode.HOLD:
        _add_unmodelled(P, duration)

    H = np.zeros((3, MOTION.size))
    nu = np.empty(3)
    for k in range(3):
        H[k, MOTION.velocity + k] = H[k, MOTION.bias + k] = 1.0
        nu[k] = after.v_WB_W[k] - x[MOTION.velocity + k] - x[MOTION.bias + k]
    seen = kalman.innovation(P, H, white, nu)
    # Of a quiet odometry a sudden push is no jump either.
    doubt = max(measurement_noise.USUAL**2 - white, 0.0)
    passed = kalman.squared_distance(seen, doubt) <= kalman.GATE
    state.velocity_nis = kalman.squared_distance(seen, 0.0)
    state.velocity_innovation[:] = nu
    if mode != UpdateMode.HOLD and not passed:
        x[:] = was
        restart(state, after.p_WB, after.v_WB_W)
        return UpdateMode.REJECT
    considered = _considered(state, mode, after.R_WB, lag_shows)
    kalman.update(x, P, seen, considered)
    _update_position(state, after.p_WB, considered)
    if mode == UpdateMode.LEARN:
        _constrain_translation(state, considered)
    most = measurement_noise.MOST
    for i in range(MOTION.bias, MOTION.accelerometer):
        x[i] = kernels.clamp(x[i], -most, most)
    return mode


@compiled
def _update_by_force(
    state: Filter, before: StateRecord, after: StateRecord, acting: Acting, F: Array
) -> None:
    """Correct the estimate at ``before`` by the specific force since; F is overwritten."""
    x, P, duration = state.translation.x, state.translation.P, acting.durations.sum()
    was = x.copy()
    predict_translation(
        state.estimated, state.drag_shape, state.translation, acting, before, after, F
    )
    later = x.copy()
    x[:] = was
    lag_shows = _lag_shows(state, F, duration)
    gravity, between = state.nominal.gravity, (before, after)
    seen = force_innovation(x, P, F, later, between, duration, gravity, state.specific_force)
    state.specific_force.nis = kalman.squared_distance(seen, 0.0)
    if not state.specific_force.nis <= kalman.GATE:
        return
    considered = _considered(state, UpdateMode.LEARN, after.R_WB, lag_shows)
    kalman.update(x, P, seen, considered)
    _constrain_translation(state, considered)
    write_estimated(state, state.estimated)
    state.specific_force.used = 1


@compiled
def _update_position(state: Filter, measured: Array, considered: Array) -> None:
    """Correct by a measured position (3,); where it jumps it is taken as it is."""
    x, P, H, nu = state.translation.x, state.translation.P, np.zeros((3, MOTION.size)), np.empty(3)
    for k in range(3):
        H[k, MOTION.position + k] = 1.0
        nu[k] = measured[k] - x[MOTION.position + k]
    variance = measurement_noise.variance_in(state.position_noise)
    seen = kalman.innovation(P, H, variance, nu)
    state.position_nis = kalman.squared_distance(seen, 0.0)
    if state.position_nis <= kalman.GATE:
        kalman.update(x, P, seen, considered)
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
    """Take position and velocity (3,) as measured, and keep what was learned, and the bias."""
    x, P = state.translation.x, state.translation.P
    for k in range(3):
        p, v, b = MOTION.position + k, MOTION.velocity + k, MOTION.bias + k
        x[p], x[v] = p_WB[k], v_WB_W[k] - x[b]
        P[p, :] = 0.0
        P[:, p] = 0.0
        P[p, p] = measurement_noise.variance_in(state.position_noise)
        # Its error is that of the bias, with the other sign, and the noise.
        P[v, :] = -P[b, :]
        P[:, v] = -P[:, b]
        P[v, v] = P[b, b] + measurement_noise.variance_in(state.velocity_noise)


@compiled
def _lag_shows(state: Filter, F: Array, duration: float) -> bool:
    """Whether the thrust changes so fast that its time constant shows in the velocity.

    By itself, and by the throttle, which has lagged with it until now.
    """
    shown, speed, P = 0.0, 0.0, state.translation.P
    if P[MOTION.lag, MOTION.lag] <= 0.0:
        return False
    lagged = P[MOTION.throttle, MOTION.lag] / P[MOTION.lag, MOTION.lag]
    for k in range(3):
        i = MOTION.velocity + k
        shown += (F[i, MOTION.lag] + F[i, MOTION.throttle] * lagged) ** 2
        speed += state.translation.x[i] ** 2
    spread = math.sqrt(state.process_noise.translation.P[MOTION.lag, MOTION.lag])
    hidden = _HIDDEN + _HIDDEN_BY_SPEED * math.sqrt(speed)
    return spread * math.sqrt(shown) > hidden * duration


@compiled
def _follow_noise(
    state: Filter,
    was: Array,
    states: tuple[StateRecord, StateRecord],
    mode: UpdateMode,
    duration: float,
) -> None:
    """Learn of the noise by two measurements and by the prediction from the estimate ``was``."""
    before, after = states
    white = measurement_noise.variance_in(state.position_noise)
    measurement_noise.follow_drift(state.drift, after.p_WB, after.v_WB_W, white, duration)
    if mode == UpdateMode.HOLD:
        state.position_noise.known = state.velocity_noise.known = 0
        return
    x = state.translation.x
    of_p = _unpredicted(before.p_WB, after.p_WB, was, x, MOTION.position)
    of_v = _unpredicted(before.v_WB_W, after.v_WB_W, was, x, MOTION.velocity)
    measurement_noise.follow(state.position_noise, of_p, duration)
    measurement_noise.follow(state.velocity_noise, of_v, duration)


@compiled
def _unpredicted(
    measured_before: Array, measured: Array, was: Array, x: Array, i: int
) -> kernels.Vector:
    """Return by how much a measured change (3,) differs from that of a block of the state."""
    return (
        measured[0] - measured_before[0] - x[i] + was[i],
        measured[1] - measured_before[1] - x[i + 1] + was[i + 1],
        measured[2] - measured_before[2] - x[i + 2] + was[i + 2],
    )


@compiled
def _add_memory(x: Array, F: Array, mode: UpdateMode, duration: float) -> None:
    """Let what lasts for a time only decay, of the estimate and in its Jacobian."""
    kept = math.exp(-duration / _BIAS_TIME)
    for k in range(3):
        x[MOTION.bias + k] *= kept
        F[MOTION.bias + k, MOTION.bias + k] = kept
    if mode == UpdateMode.LEARN:
        vertical = MOTION.disturbance + 2
        kept = math.exp(-duration / error_state.VERTICAL_TIME)
        x[vertical] *= kept
        F[vertical, vertical] = kept


@compiled
def _motion_noise(state: Filter, white: float, drifting: float, duration: float) -> Array:
    """Return the process noise over a duration, the variances (n,)."""
    P, noise, Q = state.translation.P, state.process_noise.translation, np.zeros(MOTION.size)
    # An accelerometer shows the disturbance, however noisy the velocity is.
    quieter = 1.0 if state.specific_force.used else measurement_noise.USUAL / math.sqrt(white)
    for i in range(LEARNED_STATES[0], LEARNED_STATES[1]):
        if i < MOTION.scale:
            Q[i] = noise.x[i] * quieter * max(quieter, 1.0) * duration
        elif P[i, i] < noise.P[i, i]:  # what is not observed is no less certain than at first
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
    """Add what an unknown acceleration makes of position and velocity over a duration."""
    by_p, by_v = 0.5 * duration**2 * _UNMODELLED, duration * _UNMODELLED
    for k in range(3):
        p, v = MOTION.position + k, MOTION.velocity + k
        P[p, p] += by_p**2
        P[v, v] += by_v**2
        P[p, v] += by_p * by_v
        P[v, p] += by_p * by_v


@compiled
def _considered(state: Filter, mode: UpdateMode, R_WB: Array, lag_shows: bool) -> Array:
    """Return which states of the motion (n,) are considered, not estimated."""
    considered, x = np.zeros(MOTION.size), state.translation.x
    if mode != UpdateMode.LEARN:
        considered[LEARNED_STATES[0] : LEARNED_STATES[1]] = 1.0
        return considered
    d, v = MOTION.disturbance, kernels.vector(x[MOTION.velocity : MOTION.disturbance])
    # Along the thrust, as in a climb, drag is not distinguished from thrust.
    along = kernels.dot(v, kernels.column(kernels.matrix(R_WB), 2))
    speed = kernels.dot(v, v) - along**2
    pushed = max(abs(x[d]), abs(x[d + 1])) >= state.bounds.disturbance_max
    considered[MOTION.lag] = not lag_shows
    # What a bound of the disturbance leaves is not to be taken for drag.
    considered[MOTION.drag] = speed <= _OBSERVABLE_SPEED**2 or pushed
    return considered


@compiled
def _constrain_translation(state: Filter, considered: Array) -> None:
    """Bring what was learned of the motion inside its bounds."""
    x, P, nominal = state.translation.x, state.translation.P, state.nominal
    lag, drag, d = nominal.thrust_time_constant, nominal.drag, MOTION.disturbance
    factor, farthest = error_state.LAG_FACTOR, state.bounds.disturbance_max
    latest = lag * factor + (error_state.LATEST if lag > 0.0 else 0.0)
    least, most = error_state.DRAG_FACTORS
    bounds = (
        (d, -farthest, farthest),
        (d + 1, -farthest, farthest),
        (d + 2, -VERTICAL_BOUND, VERTICAL_BOUND),
        (MOTION.drag, least * drag, max(most * drag, drag + error_state.DRAG_MORE)),
        (MOTION.lag, lag / factor, latest),
        (MOTION.scale, SCALE_BOUNDS[0], SCALE_BOUNDS[1]),
    )
    for i, low, high in bounds:
        kalman.constrain(x, P, i, (low, high), considered)
    # What went along with one may be beyond its own by now.
    for i, low, high in bounds:
        x[i] = kernels.clamp(x[i], low, high)
