"""The steps of the disturbance EKF, compiled: predict, hand over, refuse a jump, correct.

:mod:`.disturbance_ekf` has the equations.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import velocity_noise
from quad_mpc_ros.control.estimation.process_model import Prediction, Throttle, predict
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_in
from quad_mpc_ros.control.model.rollout import Body, body_in

# The estimate, one vector: first the state of the velocity's filter, whose covariance is (9, 9),
V, D, K, TAU, MU, SIZE = 0, 3, 6, 7, 8, 9
# then the throttle and its derivative by the thrust's time constant, the slow part of the
# acceleration's derivative by it, and for how long the velocity alone has been followed.
THROTTLE, THROTTLE_SLOPE, SLOW, PAUSED_FOR, ESTIMATE_SIZE = 9, 10, 11, 14, 15
LEARNABLE = slice(D, SIZE)

_ACCELERATION_NOISE = 0.1  # m/s^2 / sqrt(Hz), of the model within a step
# m/s^2 / sqrt(s), at the usual noise of the velocity; more noise is filtered for longer.
_ACCELERATION_WALK = 0.5
_VERTICAL_WALK = 0.6  # of that; winds blow along the ground
_SCALE_WALK = 0.01  # 1 / sqrt(s)
_HANDOVER = 7.0  # s, in which what pushes up or down for so long is taken for thrust
_LIFTING = 3.0  # m/s^2 of thrust upwards, below which nothing is handed over
_WANDERING = 1.0  # s, for which the error of a velocity lasts whose source tells how large it is
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
# It is learned where so much speed [m/s] tells it from wind.
_TELLING = 1.0

# An innovation beyond 5 sigma, and an attitude [rad] that the rates do not lead to, are jumps.
_JUMP, _TURN_JUMP = 30.0, 0.2

_LONGEST_PAUSE = 0.5  # s, beyond which the model without anything learned leads astray

HELD, PAUSED, LEARNED, REFUSED = range(4)
"""What an odometry is to do to the estimate, or did: nothing, tell the velocity alone, teach; or
nothing, for it jumped."""


@compiled
def update(
    nominal: Array,
    estimate: Array,
    P: Array,
    noise: Array,
    settings: tuple[float, float, float, float],
    commands: Array,
    durations: Array,
    before: Array,
    after: Array,
    lesson: int,
) -> int:
    """Predict from one odometry to the next, and correct by the second if it teaches anything.

    ``settings`` are the bounds of the throttle, that of the disturbance along the ground, and the
    variance told of the velocity.
    """
    if len(durations) == 0:
        return HELD
    lowest, highest, farthest, told = settings
    modelled, duration = parameters_in(nominal), durations.sum()
    believed_before = kernels.vector(estimate[V:D])
    prediction = _predict(modelled, estimate, commands, durations, before, after)
    for k in range(len(commands)):
        if lesson == LEARNED and not lowest < commands[k, 0] < highest:
            lesson = PAUSED
    estimate[PAUSED_FOR] = estimate[PAUSED_FOR] + duration if lesson == PAUSED else 0.0
    if lesson == HELD or estimate[PAUSED_FOR] > _LONGEST_PAUSE:
        velocity_noise.interrupt(noise)
        believe_velocity(estimate, P, after[3:6], velocity_noise.variance_in(noise))
        return HELD
    predicted = prediction.body.v
    change = kernels.plus(predicted, kernels.scaled(-1.0, believed_before))
    seen = kernels.plus(
        kernels.vector(after[3:6]), kernels.scaled(-1.0, kernels.vector(before[3:6]))
    )
    velocity_noise.follow(noise, kernels.plus(seen, kernels.scaled(-1.0, change)), duration)
    variance = max(velocity_noise.variance_in(noise), told)
    kernels.store_vector(predicted, estimate[V:D])
    by_lag = _quick_part(estimate, prediction, duration)
    wandering = _ACCELERATION_NOISE**2 + 2.0 * told / _WANDERING
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
    if _jumps(estimate, P, doubt, duration, before, after):
        believe_velocity(estimate, P, after[3:6], variance)
        return REFUSED
    lag_before = estimate[TAU]
    learned = D
    tells = False, False
    if lesson == LEARNED:
        _hand_over(estimate, P, prediction, duration)
        learned = TAU
        tells = (
            _lag_shows(modelled, by_lag, predicted, duration),
            kernels.dot(predicted, predicted) > _TELLING**2,
        )
    for axis in range(3):
        _correct_velocity(estimate, P, axis, after[3 + axis], variance, learned, tells)
    if lesson == PAUSED:
        return PAUSED
    _clamp(modelled, estimate, P, farthest)
    estimate[THROTTLE] += estimate[THROTTLE_SLOPE] * (estimate[TAU] - lag_before)
    return LEARNED


@compiled
def is_at_bounds(estimate: Array, farthest: float) -> bool:
    """Whether disturbance or scale are as far as they may go, ``farthest`` along the ground."""
    far = max(abs(estimate[D]), abs(estimate[D + 1])) >= farthest
    far = far or abs(estimate[D + 2]) >= VERTICAL_BOUND
    return bool(far or not SCALE_BOUNDS[0] < estimate[K] < SCALE_BOUNDS[1])


@compiled
def _predict(
    modelled: ModelParameters,
    estimate: Array,
    commands: Array,
    durations: Array,
    before: Array,
    after: Array,
) -> Prediction:
    """Predict by what is believed from one odometry to the next, and follow the throttle."""
    mean = modelled.drag
    uneven = kernels.scaled(estimate[MU] / mean if mean > 0.0 else 1.0, modelled.uneven_drag)
    believed = ModelParameters(
        modelled.a,
        modelled.b,
        modelled.c,
        estimate[MU],
        modelled.gravity,
        estimate[TAU],
        modelled.rate_time_constants,
        kernels.vector(estimate[D:K]),
        estimate[K],
        uneven,
        modelled.translational_lift,
        modelled.learned_drag,
        modelled.rotor_drag,
        modelled.rate_offset,
        modelled.rate_offset_by_thrust,
    )
    throttle = Throttle(estimate[THROTTLE], estimate[THROTTLE_SLOPE])
    start = body_in(before)
    start = Body(
        (0.0, 0.0, 0.0),
        kernels.vector(estimate[V:D]),
        start.R,
        (throttle.value, start.actuators[1], start.actuators[2], start.actuators[3]),
    )
    prediction = predict(believed, commands, durations, throttle, start, body_in(after).R)
    estimate[THROTTLE] = prediction.throttle.value
    estimate[THROTTLE_SLOPE] = prediction.throttle.slope
    return prediction


@compiled
def believe_velocity(estimate: Array, P: Array, v_WB_W: Array, variance: float) -> None:
    """Believe a velocity (3,) as measured, and keep what was learned."""
    for i in range(3):
        estimate[V + i] = v_WB_W[i]
        P[i, :] = 0.0
        P[:, i] = 0.0
        P[i, i] = variance


@compiled
def _quick_part(estimate: Array, prediction: Prediction, duration: float) -> kernels.Vector:
    """Return the velocity's derivative by the thrust's time constant, less what changes slowly."""
    share = 1.0 - math.exp(-duration / _SLOWLY)
    by_lag = prediction.v_by_lag
    for i in range(3):
        estimate[SLOW + i] += share * (by_lag[i] / duration - estimate[SLOW + i])
    slow = kernels.vector(estimate[SLOW : SLOW + 3])
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
    if P[MU, MU] < DRAG_SPREAD**2:  # at rest nothing tells it
        P[MU, MU] += _DRAG_WALK**2 * duration


@compiled
def _hand_over(estimate: Array, P: Array, prediction: Prediction, duration: float) -> None:
    """Turn a share of the vertical disturbance into thrust, as far as the scale may go.

    Their sum stays the same; so does its variance.
    """
    lifting, vertical = prediction.v_by_scale[2] / duration, D + 2
    if lifting < _LIFTING:
        return
    share = 1.0 - math.exp(-duration / _HANDOVER)
    scale = estimate[K] + share * estimate[vertical] / lifting
    scale = kernels.clamp(scale, SCALE_BOUNDS[0], SCALE_BOUNDS[1])
    estimate[vertical] -= lifting * (scale - estimate[K])
    estimate[K] = scale
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
    estimate: Array, P: Array, variance: float, duration: float, before: Array, after: Array
) -> bool:
    """Whether an odometry is so far from what was to be expected that it stepped."""
    square = 0.0
    for i in range(3):
        square += (after[3 + i] - estimate[i]) ** 2 / (P[i, i] + variance)
    # The attitude should have turned by the mean of the measured rates.
    turn = kernels.scaled(
        0.5 * duration, kernels.plus(kernels.vector(before[16:19]), kernels.vector(after[16:19]))
    )
    R_before, R_after = kernels.matrix_in_row(before[6:15]), kernels.matrix_in_row(after[6:15])
    R_turned = kernels.multiply(R_before, kernels.exp(turn))
    cosines = 0.0
    for i in range(9):
        cosines += R_turned[i] * R_after[i]
    return square > _JUMP or cosines < 1.0 + 2.0 * math.cos(_TURN_JUMP)


@compiled
def _correct_velocity(
    estimate: Array,
    P: Array,
    axis: int,
    measured: float,
    variance: float,
    learned: int,
    tells: tuple[bool, bool],
) -> None:
    """Correct by the measured velocity along one axis of the world.

    What comes from ``learned`` on in the state has no gain, as in Schmidt's filter: for any gain K
    P <- P - K h' - h K' + s K K', with h = P H' and s the variance of the innovation.
    """
    row = P[axis].copy()
    total = row[axis] + variance
    gain = row / total
    gain[learned:TAU] = 0.0
    gain[TAU] *= tells[0]
    gain[MU] *= tells[1]
    innovation = measured - estimate[axis]
    for i in range(SIZE):
        estimate[i] += gain[i] * innovation
        for j in range(SIZE):
            P[i, j] += total * gain[i] * gain[j] - gain[i] * row[j] - row[i] * gain[j]


@compiled
def _clamp(modelled: ModelParameters, estimate: Array, P: Array, farthest: float) -> None:
    """Bring what the velocity taught inside its bounds, ``farthest`` that along the ground."""
    for i in range(3):
        bound = VERTICAL_BOUND if i == 2 else farthest
        estimate[D + i] = kernels.clamp(estimate[D + i], -bound, bound)
    estimate[K] = kernels.clamp(estimate[K], SCALE_BOUNDS[0], SCALE_BOUNDS[1])
    lag = modelled.thrust_time_constant
    estimate[TAU] = kernels.clamp(estimate[TAU], lag / _LAG_BOUND, lag * _LAG_BOUND)
    most = max(modelled.drag * _DRAG_MOST, modelled.drag + _DRAG_MORE)
    drag, bounded = estimate[MU], not abs(estimate[D]) < farthest > abs(estimate[D + 1])
    estimate[MU] = kernels.clamp(drag, _DRAG_LEAST * modelled.drag, most)
    if bounded or estimate[MU] != drag:
        # What a bound holds explains no more, and is not to spoil what could.
        for j in range(SIZE):
            P[MU, j] = 0.0
            P[j, MU] = 0.0
        P[MU, MU] = _DRAG_WALK**2
