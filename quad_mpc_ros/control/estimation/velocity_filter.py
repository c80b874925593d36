"""The steps of the disturbance EKF, compiled: predict, hand over, reject a jump, correct.

:mod:`.disturbance_ekf` has the equations.
"""

from __future__ import annotations

import math
from typing import Annotated

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.estimation import velocity_noise
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.process_model import MotionPrediction, Throttle, predict
from quad_mpc_ros.control.estimation.velocity_noise import VelocityNoise
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rollout import Body, StateRecord, body_in

# Where in the state begin: velocity, disturbance, thrust scale, thrust's time constant, drag.
V, D, K, TAU, MU, SIZE = 0, 3, 6, 7, 8, 9
LEARNABLE = slice(D, SIZE)


class VelocityEstimate(Record):
    """What the filter of the velocity knows."""

    x: Annotated[Array, (SIZE,)]
    P: Annotated[Array, (SIZE, SIZE)]
    # The throttle, its derivative by the thrust's time constant, and the slow part of the
    # acceleration's derivative by it.
    throttle: float
    throttle_slope: float
    slow: Vector3
    paused_for: float  # s, for how long the velocity alone has been estimated


class Bounds(Record):
    """Within what commands and estimate are."""

    throttle_min: float
    throttle_max: float
    disturbance_max: float  # m/s^2, along the ground


_ACCELERATION_NOISE = 0.1  # m/s^2 / sqrt(Hz), of the model within a step
# m/s^2 / sqrt(s), at the usual noise of the velocity; more noise is filtered for longer.
_ACCELERATION_WALK = 0.5
_VERTICAL_WALK = 0.6  # of that; winds blow along the ground
_SCALE_WALK = 0.01  # 1 / sqrt(s)
_HANDOVER = 7.0  # s, in which what pushes up or down for so long is taken for thrust
_LIFTING = 3.0  # m/s^2 of thrust upwards, below which nothing is handed over
_WANDERING = 1.0  # s, for which the error of a velocity with a given variance lasts
VERTICAL_BOUND = 3.0  # m/s^2
SCALE_BOUNDS = (0.5, 1.5)
LAG_SPREAD, _LAG_WALK = 0.5, 0.1  # of the time constant, relative; the walk 1 / sqrt(s)
_LAG_BOUND = 2.0  # of the time constant, as a factor either way
# It is learned from thrust that changes within so many seconds, for what changes slowly looks like
# drag, and where it shows by more than so much [m/s^2], at rest and per m/s.
_SLOWLY, _HIDDEN, _HIDDEN_BY_SPEED = 0.2, 0.05, 0.05

DRAG_SPREAD, _DRAG_WALK = 0.3, 0.05  # 1/s; the walk 1/s / sqrt(s)
# Of what is configured at least this, and at most the more of that and 1/s beyond it.
_DRAG_LEAST, _DRAG_MOST, _DRAG_MORE = 0.1, 3.0, 0.8
# It is learned above this speed [m/s], which distinguishes it from wind.
_OBSERVABLE_SPEED = 1.0

# An innovation beyond 5 sigma, and an attitude [rad] that the rates do not lead to, are jumps.
_JUMP, _TURN_JUMP = 30.0, 0.2

_LONGEST_PAUSE = 0.5  # s, beyond which the model without anything learned leads astray

HELD, PAUSED, LEARNED, REFUSED = range(4)
"""Update modes, and what became of an odometry: nothing is estimated; the velocity alone; all; or
nothing, for it jumped."""


@compiled
def update(
    modelled: ModelParameters,
    scratch: ModelParameters,
    estimate: VelocityEstimate,
    noise: VelocityNoise,
    bounds: Bounds,
    acting: Acting,
    before: StateRecord,
    after: StateRecord,
    mode: int,
    given_variance: float,
) -> int:
    """Predict from one odometry to the next, and correct by the second as the mode allows.

    ``modelled`` are the configured parameters; ``scratch`` is overwritten with those estimated.
    ``given_variance`` [m^2/s^2] is that of the second velocity, 0 where it is not known.
    """
    commands, durations = acting.commands, acting.durations
    if len(durations) == 0:
        return HELD
    duration, x, P = durations.sum(), estimate.x, estimate.P
    v_before, measured = kernels.vector(x[V:D]), kernels.vector(after.v_WB_W)
    prediction = _predict(modelled, scratch, estimate, acting, before, after)
    for k in range(len(commands)):
        within = bounds.throttle_min < commands[k, 0] < bounds.throttle_max
        if mode == LEARNED and not within:
            mode = PAUSED
    estimate.paused_for = estimate.paused_for + duration if mode == PAUSED else 0.0
    if mode == HELD or estimate.paused_for > _LONGEST_PAUSE:
        velocity_noise.interrupt(noise)
        take_velocity(estimate, after.v_WB_W, velocity_noise.variance_in(noise))
        return HELD
    predicted = prediction.body.v
    change = kernels.plus(predicted, kernels.scaled(-1.0, v_before))
    seen = kernels.plus(measured, kernels.scaled(-1.0, kernels.vector(before.v_WB_W)))
    velocity_noise.follow(noise, kernels.plus(seen, kernels.scaled(-1.0, change)), duration)
    variance = max(velocity_noise.variance_in(noise), given_variance)
    kernels.store_vector(predicted, x[V:D])
    by_lag = _quick_part(estimate, prediction, duration)
    wandering = _ACCELERATION_NOISE**2 + 2.0 * given_variance / _WANDERING
    quieter = velocity_noise.USUAL / math.sqrt(variance)
    walk = _ACCELERATION_WALK**2 * quieter * max(quieter, 1.0)
    _predict_covariance(
        modelled,
        P,
        (prediction.v_by_scale, by_lag, prediction.v_by_drag),
        duration,
        (wandering, walk),
    )
    # Of a quiet odometry a sudden push is no jump either.
    doubt = max(variance, velocity_noise.USUAL**2)
    if _jumps(estimate, doubt, duration, before, after):
        take_velocity(estimate, after.v_WB_W, variance)
        return REFUSED
    lag_before = x[TAU]
    learned = D
    observable = False, False
    if mode == LEARNED:
        _hand_over(x, P, prediction, duration)
        learned = TAU
        observable = (
            _lag_shows(modelled, by_lag, predicted, duration),
            kernels.dot(predicted, predicted) > _OBSERVABLE_SPEED**2,
        )
    for axis in range(3):
        _correct_velocity(x, P, axis, measured[axis], variance, learned, observable)
    if mode == PAUSED:
        return PAUSED
    _clamp(modelled, x, P, bounds.disturbance_max)
    estimate.throttle += estimate.throttle_slope * (x[TAU] - lag_before)
    return LEARNED


@compiled
def is_at_bounds(estimate: VelocityEstimate, bounds: Bounds) -> bool:
    """Whether disturbance or scale are as far as they may go."""
    x = estimate.x
    far = max(abs(x[D]), abs(x[D + 1])) >= bounds.disturbance_max
    far = far or abs(x[D + 2]) >= VERTICAL_BOUND
    return bool(far or not SCALE_BOUNDS[0] < x[K] < SCALE_BOUNDS[1])


@compiled
def _predict(
    modelled: ModelParameters,
    scratch: ModelParameters,
    estimate: VelocityEstimate,
    acting: Acting,
    before: StateRecord,
    after: StateRecord,
) -> MotionPrediction:
    """Predict by the estimate from one odometry to the next, and follow the throttle."""
    x, mean = estimate.x, modelled.drag
    factor = x[MU] / mean if mean > 0.0 else 1.0
    uneven = kernels.scaled(factor, kernels.vector(modelled.uneven_drag))
    scratch.drag, scratch.thrust_time_constant, scratch.thrust_scale = x[MU], x[TAU], x[K]
    kernels.store_vector(kernels.vector(x[D:K]), scratch.a_W)
    kernels.store_vector(uneven, scratch.uneven_drag)
    throttle = Throttle(estimate.throttle, estimate.throttle_slope)
    start, w = body_in(before), before.w_WB_B
    start = Body(
        (0.0, 0.0, 0.0),
        kernels.vector(x[V:D]),
        start.R,
        (throttle.value, w[0], w[1], w[2]),
    )
    R_after = kernels.matrix(after.R_WB)
    prediction = predict(scratch, acting.commands, acting.durations, throttle, start, R_after)
    estimate.throttle = prediction.throttle.value
    estimate.throttle_slope = prediction.throttle.slope
    return prediction


@compiled
def take_velocity(estimate: VelocityEstimate, v_WB_W: Array, variance: float) -> None:
    """Take a velocity (3,) as measured, and keep what was learned."""
    x, P = estimate.x, estimate.P
    for i in range(3):
        x[V + i] = v_WB_W[i]
        P[i, :] = 0.0
        P[:, i] = 0.0
        P[i, i] = variance


@compiled
def _quick_part(
    estimate: VelocityEstimate, prediction: MotionPrediction, duration: float
) -> kernels.Vector:
    """Return the velocity's derivative by the thrust's time constant, less what changes slowly."""
    share = 1.0 - math.exp(-duration / _SLOWLY)
    by_lag = prediction.v_by_lag
    for i in range(3):
        estimate.slow[i] += share * (by_lag[i] / duration - estimate.slow[i])
    slow = kernels.vector(estimate.slow)
    return kernels.plus(by_lag, kernels.scaled(-duration, slow))


@compiled
def _predict_covariance(
    modelled: ModelParameters,
    P: Array,
    v_by: tuple[kernels.Vector, kernels.Vector, kernels.Vector],
    duration: float,
    growth: tuple[float, float],
) -> None:
    """Let the uncertainty grow over a duration: F P F' and the random walks.

    ``v_by`` are the derivatives of the velocity by the thrust's scale, its time constant and drag,
    ``growth`` is that of velocity [m^2/s^3] and disturbance [m^2/s^5], per second.
    """
    kept = 1.0 - duration * modelled.drag
    for i in range(3):
        by_scale, by_lag, by_drag = v_by[0][i], v_by[1][i], v_by[2][i]
        for j in range(SIZE):
            others = duration * P[D + i, j] + by_scale * P[K, j] + by_lag * P[TAU, j]
            others += by_drag * P[MU, j]
            P[i, j] = kept * P[i, j] + others
    for i in range(3):
        by_scale, by_lag, by_drag = v_by[0][i], v_by[1][i], v_by[2][i]
        for j in range(SIZE):
            others = duration * P[j, D + i] + by_scale * P[j, K] + by_lag * P[j, TAU]
            others += by_drag * P[j, MU]
            P[j, i] = kept * P[j, i] + others
    for i in range(3):
        P[i, i] += growth[0] * duration
        P[D + i, D + i] += growth[1] * duration * (_VERTICAL_WALK**2 if i == 2 else 1.0)
    P[K, K] += _SCALE_WALK**2 * duration
    P[TAU, TAU] += (_LAG_WALK * modelled.thrust_time_constant) ** 2 * duration
    if P[MU, MU] < DRAG_SPREAD**2:  # unobservable at rest
        P[MU, MU] += _DRAG_WALK**2 * duration


@compiled
def _hand_over(x: Array, P: Array, prediction: MotionPrediction, duration: float) -> None:
    """Turn a share of the vertical disturbance into thrust, as far as the scale may go.

    Their sum stays the same; so does its variance.
    """
    lifting, vertical = prediction.v_by_scale[2] / duration, D + 2
    if lifting < _LIFTING:
        return
    share = 1.0 - math.exp(-duration / _HANDOVER)
    scale = x[K] + share * x[vertical] / lifting
    scale = kernels.clamp(scale, SCALE_BOUNDS[0], SCALE_BOUNDS[1])
    x[vertical] -= lifting * (scale - x[K])
    x[K] = scale
    for j in range(SIZE):
        P[K, j] += share / lifting * P[vertical, j]
        P[vertical, j] *= 1.0 - share
    for j in range(SIZE):
        P[j, K] += share / lifting * P[j, vertical]
        P[j, vertical] *= 1.0 - share


@compiled
def _lag_shows(
    modelled: ModelParameters, by_lag: kernels.Vector, v: kernels.Vector, duration: float
) -> bool:
    """Whether the thrust changes so fast that its time constant shows in the velocity."""
    shown = LAG_SPREAD * modelled.thrust_time_constant * math.sqrt(kernels.dot(by_lag, by_lag))
    hidden = _HIDDEN + _HIDDEN_BY_SPEED * math.sqrt(kernels.dot(v, v))
    return shown > hidden * duration


@compiled
def _jumps(
    estimate: VelocityEstimate,
    variance: float,
    duration: float,
    before: StateRecord,
    after: StateRecord,
) -> bool:
    """Whether an odometry is so far from what was to be expected that it stepped."""
    square = 0.0
    for i in range(3):
        square += (after.v_WB_W[i] - estimate.x[i]) ** 2 / (estimate.P[i, i] + variance)
    # The attitude should have turned by the mean of the measured rates.
    w = kernels.plus(kernels.vector(before.w_WB_B), kernels.vector(after.w_WB_B))
    turn, R_after = kernels.scaled(0.5 * duration, w), kernels.matrix(after.R_WB)
    R_turned = kernels.multiply(kernels.matrix(before.R_WB), kernels.exp(turn))
    cosines = 0.0
    for i in range(9):
        cosines += R_turned[i] * R_after[i]
    return square > _JUMP or cosines < 1.0 + 2.0 * math.cos(_TURN_JUMP)


@compiled
def _correct_velocity(
    x: Array,
    P: Array,
    axis: int,
    measured: float,
    variance: float,
    learned: int,
    observable: tuple[bool, bool],
) -> None:
    """Correct by the measured velocity along one axis of the world.

    What comes from ``learned`` on in the state has no gain, as in Schmidt's filter: for any gain K
    P <- P - K h' - h K' + s K K', with h = P H' and s the variance of the innovation.
    """
    row = P[axis].copy()
    total = row[axis] + variance
    gain = row / total
    gain[learned:TAU] = 0.0
    gain[TAU] *= observable[0]
    gain[MU] *= observable[1]
    innovation = measured - x[axis]
    for i in range(SIZE):
        x[i] += gain[i] * innovation
        for j in range(SIZE):
            P[i, j] += total * gain[i] * gain[j] - gain[i] * row[j] - row[i] * gain[j]


@compiled
def _clamp(modelled: ModelParameters, x: Array, P: Array, farthest: float) -> None:
    """Bring what was learned inside its bounds, ``farthest`` that along the ground."""
    for i in range(3):
        bound = VERTICAL_BOUND if i == 2 else farthest
        x[D + i] = kernels.clamp(x[D + i], -bound, bound)
    x[K] = kernels.clamp(x[K], SCALE_BOUNDS[0], SCALE_BOUNDS[1])
    lag = modelled.thrust_time_constant
    x[TAU] = kernels.clamp(x[TAU], lag / _LAG_BOUND, lag * _LAG_BOUND)
    most = max(modelled.drag * _DRAG_MOST, modelled.drag + _DRAG_MORE)
    drag, bounded = x[MU], not abs(x[D]) < farthest > abs(x[D + 1])
    x[MU] = kernels.clamp(drag, _DRAG_LEAST * modelled.drag, most)
    if bounded or x[MU] != drag:
        # What a bound holds explains no more, and is not to spoil what could.
        for j in range(SIZE):
            P[MU, j] = 0.0
            P[j, MU] = 0.0
        P[MU, MU] = _DRAG_WALK**2
