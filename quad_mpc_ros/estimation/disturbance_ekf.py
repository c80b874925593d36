"""The disturbance EKF: what the model does not know, learned from what the vehicle does.

Between two odometries the velocity and the body rates are predicted with the commands that were
really acting, delayed and lagged. Two extended Kalman filters correct by the innovation, what was
measured less what was predicted. The filter of the velocity has the state x = (v, d, k, tau_s):

- v, the velocity in the world,
- d, an acceleration in the world (wind, drag), and k, a factor on the thrust (mass, battery): they
  look alike at hover and part company as the vehicle tilts,
- tau_s, the time constant of the thrust, through the velocity's sensitivity to it,

    predict   x <- f(x),  P <- F P F' + Q      F = df/dx, differs from one in the rows of v alone
    update    K = P H' / (H P H' + r),  x <- x + K (z - H x),  P <- P - K H P      axis by axis

The filter of the body rates has the one state tau_w, their time constant, through the rates'
sensitivity to it. All but v are random walks, clamped to bounds. They are kept as they are where
the caller says that nothing can be learned, and where the commands are saturated. A time constant
of zero is no lag and stays. The throttle, which nobody measures, is followed through the lag.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.estimation.command_history import Acting
from quad_mpc_ros.estimation.process_model import Prediction, Throttle, predict
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.parameters import (
    DISTURBANCE,
    RATE_TIME_CONSTANT,
    THRUST_SCALE,
    THRUST_TIME_CONSTANT,
    ModelParameters,
    parameters_in,
)
from quad_mpc_ros.model.rollout import Body, body_in

# The estimate, one vector: first the state of the velocity's filter, whose covariance is (8, 8),
_V, _D, _K, _TAU, _SIZE = 0, 3, 6, 7, 8
# then the throttle and its derivative by the thrust's time constant, the rates' time constant and
# its variance.
_THROTTLE, _THROTTLE_SLOPE, _RATE_TAU, _RATE_VARIANCE = 8, 9, 10, 11
_ESTIMATE_SIZE = 12

_VELOCITY_NOISE = 0.1  # m/s, of a measurement: more than any, for commands answer it too
_ACCELERATION_NOISE = 0.3  # m/s^2 / sqrt(Hz), of the model within a step
_ACCELERATION_WALK = 1.5  # m/s^2 / sqrt(s)
_SCALE_WALK = 0.05  # 1 / sqrt(s)
_ACCELERATION_SPREAD, _SCALE_SPREAD = 1.0, 0.2  # at the start
_ACCELERATION_BOUND = 5.0  # m/s^2
SCALE_BOUNDS = (0.5, 1.5)

_RATE_NOISE = 0.1  # rad/s, of a measured rate against the model
_LAG_SPREAD = 0.5  # of a time constant at the start, relative
_LAG_WALK = 0.1  # relative, 1 / sqrt(s)
_LAG_BOUND = 2.0  # of a time constant, as a factor either way


class EkfMemory(NamedTuple):
    """What is believed at a moment: the estimate, and the covariance of the velocity's filter."""

    estimate: Array
    covariance: Array


class DisturbanceEkf:
    """Follows a vehicle from odometry to odometry."""

    def __init__(self, nominal: Array, *, throttle: float) -> None:
        """``nominal`` are the configured parameters (11,), ``throttle`` is where it begins."""
        thrust_lag, rate_lag = nominal[THRUST_TIME_CONSTANT], nominal[RATE_TIME_CONSTANT]
        self._nominal = nominal
        self._initial_throttle = throttle
        self._estimate = np.zeros(_ESTIMATE_SIZE)
        self._estimate[_K], self._estimate[_TAU] = 1.0, thrust_lag
        self._estimate[_RATE_TAU] = rate_lag
        self._estimate[_RATE_VARIANCE] = (_LAG_SPREAD * rate_lag) ** 2
        self._covariance = np.zeros((_SIZE, _SIZE))
        self._covariance[_D:_K, _D:_K] = np.eye(3) * _ACCELERATION_SPREAD**2
        self._covariance[_K, _K] = _SCALE_SPREAD**2
        self._covariance[_TAU, _TAU] = (_LAG_SPREAD * thrust_lag) ** 2
        self._saturation = np.array([-math.inf, math.inf])
        self.start(np.zeros(3))

    def reconfigure(self, *, throttle_min: float, throttle_max: float) -> None:
        """Take over changed bounds of the throttle."""
        self._saturation[:] = throttle_min, throttle_max

    @property
    def throttle(self) -> float:
        """The throttle that the vehicle has by now."""
        return float(self._estimate[_THROTTLE])

    def parameters(self) -> Array:
        """Return the parameters (11,) as believed by now."""
        believed = self._nominal.copy()
        believed[THRUST_TIME_CONSTANT] = self._estimate[_TAU]
        believed[RATE_TIME_CONSTANT] = self._estimate[_RATE_TAU]
        believed[DISTURBANCE] = self._estimate[_D:_K]
        believed[THRUST_SCALE] = self._estimate[_K]
        return believed

    def memory(self) -> EkfMemory:
        """Return what is believed, and how firmly."""
        return EkfMemory(self._estimate.copy(), self._covariance.copy())

    def recall(self, memory: EkfMemory) -> None:
        """Believe again what was believed, of all but the present velocity and throttle."""
        learned = (*range(_D, _SIZE), _RATE_TAU, _RATE_VARIANCE)
        for index in learned:
            self._estimate[index] = memory.estimate[index]
        self._covariance[:] = memory.covariance
        _believe_velocity(self._estimate, self._covariance, self._estimate[_V:_D].copy())

    def start(self, v_WB_W: Array) -> None:
        """Begin with a velocity (3,); what was learned is kept."""
        self._estimate[_THROTTLE] = self._initial_throttle
        self._estimate[_THROTTLE_SLOPE] = 0.0
        _believe_velocity(self._estimate, self._covariance, v_WB_W)

    def update(self, *, before: Array, after: Array, acting: Acting, frozen: bool) -> None:
        """Go on from one odometry to the next, under the commands that acted between them.

        ``before`` and ``after`` are their states, rows (19,) of
        :mod:`~quad_mpc_ros.model.rollout`. ``frozen`` learns nothing, and follows the throttle.
        """
        _update(
            nominal=self._nominal,
            estimate=self._estimate,
            P=self._covariance,
            saturation=self._saturation,
            commands=acting.commands,
            durations=acting.durations,
            before=before,
            after=after,
            frozen=frozen,
        )


@compiled
def _update(
    nominal: Array,
    estimate: Array,
    P: Array,
    saturation: Array,
    commands: Array,
    durations: Array,
    before: Array,
    after: Array,
    frozen: bool,
) -> None:
    """Predict from one odometry to the next, and correct by the second if it teaches anything."""
    if len(durations) == 0:
        return
    modelled, duration = parameters_in(nominal), durations.sum()
    prediction = _predict(modelled, estimate, commands, durations, before, after)
    for k in range(len(commands)):
        frozen |= not saturation[0] < commands[k, 0] < saturation[1]
    if frozen:
        _believe_velocity(estimate, P, after[3:6])
        return
    kernels.store_vector(prediction.body.v, estimate[_V:_D])
    _predict_covariance(modelled, P, prediction, duration)
    lag_before = estimate[_TAU]
    for axis in range(3):
        _correct_velocity(estimate, P, axis, after[3 + axis])
    _clamp(modelled, estimate)
    estimate[_THROTTLE] += estimate[_THROTTLE_SLOPE] * (estimate[_TAU] - lag_before)
    _correct_rate_lag(modelled, estimate, prediction, after[16:19], duration)


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
    believed = ModelParameters(
        modelled.a,
        modelled.b,
        modelled.c,
        modelled.drag,
        modelled.gravity,
        estimate[_TAU],
        estimate[_RATE_TAU],
        kernels.vector(estimate[_D:_K]),
        estimate[_K],
    )
    throttle = Throttle(estimate[_THROTTLE], estimate[_THROTTLE_SLOPE])
    start = body_in(before)
    start = Body(
        (0.0, 0.0, 0.0),
        kernels.vector(estimate[_V:_D]),
        start.R,
        (throttle.value, start.actuators[1], start.actuators[2], start.actuators[3]),
    )
    prediction = predict(believed, commands, durations, throttle, start, body_in(after).R)
    estimate[_THROTTLE] = prediction.throttle.value
    estimate[_THROTTLE_SLOPE] = prediction.throttle.slope
    return prediction


@compiled
def _believe_velocity(estimate: Array, P: Array, v_WB_W: Array) -> None:
    """Believe a velocity (3,) as measured, and keep what was learned."""
    for i in range(3):
        estimate[_V + i] = v_WB_W[i]
        P[i, :] = 0.0
        P[:, i] = 0.0
        P[i, i] = _VELOCITY_NOISE**2


@compiled
def _predict_covariance(
    modelled: ModelParameters, P: Array, prediction: Prediction, duration: float
) -> None:
    """Let the uncertainty grow over a duration: F P F' and the random walks."""
    kept = 1.0 - duration * modelled.drag
    for i in range(3):
        by_scale, by_lag = prediction.v_by_scale[i], prediction.v_by_lag[i]
        for j in range(_SIZE):
            others = duration * P[_D + i, j] + by_scale * P[_K, j] + by_lag * P[_TAU, j]
            P[i, j] = kept * P[i, j] + others
    for i in range(3):
        by_scale, by_lag = prediction.v_by_scale[i], prediction.v_by_lag[i]
        for j in range(_SIZE):
            others = duration * P[j, _D + i] + by_scale * P[j, _K] + by_lag * P[j, _TAU]
            P[j, i] = kept * P[j, i] + others
    for i in range(3):
        P[i, i] += _ACCELERATION_NOISE**2 * duration
        P[_D + i, _D + i] += _ACCELERATION_WALK**2 * duration
    P[_K, _K] += _SCALE_WALK**2 * duration
    P[_TAU, _TAU] += (_LAG_WALK * modelled.thrust_time_constant) ** 2 * duration


@compiled
def _correct_velocity(estimate: Array, P: Array, axis: int, measured: float) -> None:
    """Correct by the measured velocity along one axis of the world."""
    row = P[axis].copy()
    variance = row[axis] + _VELOCITY_NOISE**2
    innovation = measured - estimate[axis]
    for i in range(_SIZE):
        gain = row[i] / variance
        estimate[i] += gain * innovation
        for j in range(_SIZE):
            P[i, j] -= gain * row[j]


@compiled
def _clamp(modelled: ModelParameters, estimate: Array) -> None:
    """Bring what the velocity taught inside its bounds."""
    for i in range(3):
        estimate[_D + i] = kernels.clamp(
            estimate[_D + i], -_ACCELERATION_BOUND, _ACCELERATION_BOUND
        )
    estimate[_K] = kernels.clamp(estimate[_K], SCALE_BOUNDS[0], SCALE_BOUNDS[1])
    estimate[_TAU] = _clamped_lag(estimate[_TAU], modelled.thrust_time_constant)


@compiled
def _clamped_lag(time_constant: float, modelled: float) -> float:
    return kernels.clamp(time_constant, modelled / _LAG_BOUND, modelled * _LAG_BOUND)


@compiled
def _correct_rate_lag(
    modelled: ModelParameters,
    estimate: Array,
    prediction: Prediction,
    measured: Array,
    duration: float,
) -> None:
    """Correct the rates' time constant by the measured rates, axis by axis."""
    predicted, slopes = prediction.body.actuators[1:], prediction.w_by_lag
    if modelled.rate_time_constant <= 0.0:
        return
    time_constant, variance = estimate[_RATE_TAU], estimate[_RATE_VARIANCE]
    before = time_constant
    variance += (_LAG_WALK * modelled.rate_time_constant) ** 2 * duration
    for i in range(3):
        gain = variance * slopes[i] / (slopes[i] ** 2 * variance + _RATE_NOISE**2)
        innovation = measured[i] - predicted[i] - slopes[i] * (time_constant - before)
        time_constant += gain * innovation
        variance -= gain * slopes[i] * variance
    estimate[_RATE_TAU] = _clamped_lag(time_constant, modelled.rate_time_constant)
    estimate[_RATE_VARIANCE] = variance
