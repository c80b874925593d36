"""Estimating what the model does not know: disturbance, thrust, and how far the actuators lag.

Between two odometries the velocity and the body rates are predicted with the commands that were
really acting, delayed and lagged, and what was measured instead corrects

- an acceleration in the world (wind, drag) and a factor on the thrust (mass, battery), which look
  alike at hover and part company as the vehicle tilts,
- the time constant of the thrust, through the velocity's sensitivity to it,
- the time constant of the body rates, through theirs.

All are random walks of extended Kalman filters, bounded, and kept as they are on the ground and
while the throttle is at a bound. A time constant of zero is no lag and stays. The throttle, which
nobody measures, is followed through the lag.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.command_history import Interval
from quad_mpc_ros.control.prediction import Disturbance, Model, Motion, advance
from quad_mpc_ros.core.compiled import compiled
from quad_mpc_ros.core.messages import Array

# State of the filter: velocity, acceleration, factor on the thrust, time constant of the thrust.
_V, _D, _K, _TAU, _SIZE = 0, 3, 6, 7, 8

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

# Longest stretch predicted at once [s].
_LONGEST = 0.0025
# At rest and not lifted: on the ground, which carries what the thrust does not. In flight at rest
# the thrust is the weight, up to its scale; less than the last of these says that it has landed.
_REST_SPEED, _LIFT, _LANDED = 0.1, 0.95, 0.6


class _Memory(NamedTuple):
    """``x`` (8,) and ``P`` (8, 8) of the velocity's filter; ``throttle`` (2,) with its derivative
    by the time constant; ``rate_lag`` (2,): time constant of the rates and its variance.
    """

    x: Array
    P: Array
    throttle: Array
    rate_lag: Array


class _Slopes(NamedTuple):
    """How an interval changes: by the thrust's scale (3,) and by the time constants.

    ``v_by_scale`` and ``v_by_lag`` (3,) of the velocity, ``w_by_lag`` (3,) of the rates.
    """

    v_by_scale: Array
    v_by_lag: Array
    w_by_lag: Array


class VehicleEstimator:
    """Follows a vehicle from odometry to odometry; without ``learning`` only its throttle."""

    def __init__(self, model: Model, *, throttle: float, learning: bool) -> None:
        self._modelled = model
        self._learning = learning
        self._throttle = throttle
        self._memory = _Memory(
            x=np.zeros(_SIZE),
            P=np.zeros((_SIZE, _SIZE)),
            throttle=np.array((throttle, 0.0)),
            rate_lag=np.array(
                (model.rate_time_constant, (_LAG_SPREAD * model.rate_time_constant) ** 2)
            ),
        )
        x, P = self._memory.x, self._memory.P
        x[_K], x[_TAU] = 1.0, model.thrust_time_constant
        P[_D : _D + 3, _D : _D + 3] = np.eye(3) * _ACCELERATION_SPREAD**2
        P[_K, _K] = _SCALE_SPREAD**2
        P[_TAU, _TAU] = (_LAG_SPREAD * model.thrust_time_constant) ** 2
        self._flown = False

    @property
    def throttle(self) -> float:
        """The throttle that the vehicle has by now."""
        return float(self._memory.throttle[0])

    @property
    def disturbance(self) -> Disturbance:
        """The present estimate of the disturbance."""
        x = self._memory.x
        return Disturbance(a_W=x[_D : _D + 3].copy(), thrust_scale=float(x[_K]))

    @property
    def model(self) -> Model:
        """The model with the present estimate of its time constants."""
        return self._modelled._replace(
            thrust_time_constant=float(self._memory.x[_TAU]),
            rate_time_constant=float(self._memory.rate_lag[0]),
        )

    def start(self, v_WB_W: Array) -> None:
        """Believe a velocity (3,), perhaps on the ground, and keep what was learned."""
        _restart(self._memory, v_WB_W)
        self._memory.throttle[:] = self._throttle, 0.0
        self._flown = False

    def follow(
        self,
        *,
        R_before: Array,
        w_before: Array,
        R_after: Array,
        w_after: Array,
        v_after: Array,
        acting: Iterable[Interval],
        frozen: bool,
    ) -> None:
        """Go on from one odometry to the next, under the commands that acted between them.

        Attitudes (3, 3) and body rates (3,) are those of the two, ``v_after`` (3,) is the second's
        velocity in the world. ``frozen`` learns nothing.
        """
        intervals = [interval for interval in acting if interval.duration > 0.0]
        if not intervals:
            return
        commands = np.array([interval.command.vector() for interval in intervals])
        durations = np.array([interval.duration for interval in intervals])
        axis = _mean_axis(R_before[:, 2], R_after[:, 2])
        reached = Motion(
            p_WB=np.zeros((1, 3)),
            v_WB_W=self._memory.x[None, _V : _V + 3].copy(),
            R_WB=R_before[None].copy(),
            actuators=np.array(((self.throttle, *w_before),)),
        )
        slopes = _followed(self.model, self._memory, commands, durations, axis, reached)
        if not self._learning:
            return
        thrust = slopes.v_by_scale[2] / durations.sum()
        resting = float(v_after @ v_after) < _REST_SPEED**2
        if not resting or thrust > _LIFT * self._modelled.gravity:
            self._flown = True
        elif thrust < _LANDED * self._modelled.gravity:
            self._flown = False
        if frozen or not self._flown:
            _restart(self._memory, v_after)
            return
        _learn(self._modelled, self._memory, slopes, reached, v_after, w_after, durations.sum())


def _mean_axis(before: Array, after: Array) -> Array:
    """Return the mean of a direction that turned evenly from one to another (Simpson)."""
    middle = before + after
    length = float(np.sqrt(middle @ middle))
    if length < 1e-6:
        return np.asarray(after)
    return np.asarray((before + after + 4.0 * middle / length) / 6.0)


@compiled
def _restart(memory: _Memory, v_WB_W: Array) -> None:
    for i in range(3):
        memory.x[i] = v_WB_W[i]
        memory.P[i, :] = 0.0
        memory.P[:, i] = 0.0
        memory.P[i, i] = _VELOCITY_NOISE**2


@compiled
def _lag_slopes(time_constant: float, duration: float) -> tuple[float, float, float, float]:
    """Return decay and mean share of a first-order lag, and their derivatives by its constant."""
    if time_constant <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    decay = math.exp(-duration / time_constant)
    decay_slope = decay * duration / time_constant**2
    share = time_constant * (1.0 - decay) / duration
    return (
        decay,
        share,
        decay_slope,
        share / time_constant - time_constant * decay_slope / duration,
    )


@compiled
def _followed(
    model: Model,
    memory: _Memory,
    commands: Array,
    durations: Array,
    thrust_axis_W: Array,
    reached: Motion,
) -> _Slopes:
    """Move a state on through commands (n, 4) by what is believed; return its slopes."""
    x = memory.x
    throttle, slope = memory.throttle[0], memory.throttle[1]
    v_by_scale, v_by_lag, w_by_lag = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(len(durations)):
        dt = durations[k]
        decay, share, decay_slope, share_slope = _lag_slopes(model.rate_time_constant, dt)
        for i in range(3):
            excess = reached.actuators[0, 1 + i] - commands[k, 1 + i]
            w_by_lag[i] = decay * w_by_lag[i] + decay_slope * excess
        decay, share, decay_slope, share_slope = _lag_slopes(model.thrust_time_constant, dt)
        excess = throttle - commands[k, 0]
        mean, mean_slope = commands[k, 0] + share * excess, share * slope + share_slope * excess
        throttle, slope = commands[k, 0] + decay * excess, decay * slope + decay_slope * excess
        push = dt * ((model.a * mean + model.b) * mean + model.c)
        push_slope = dt * x[_K] * (2.0 * model.a * mean + model.b) * mean_slope
        for i in range(3):
            v_by_scale[i] += push * thrust_axis_W[i]
            v_by_lag[i] += push_slope * thrust_axis_W[i]
        advance(model, x[_D : _D + 3], x[_K], commands[k], dt, _LONGEST, reached)
    memory.throttle[0], memory.throttle[1] = throttle, slope
    return _Slopes(v_by_scale, v_by_lag, w_by_lag)


@compiled
def _learn(
    model: Model,
    memory: _Memory,
    slopes: _Slopes,
    reached: Motion,
    v_WB_W: Array,
    w_WB_B: Array,
    duration: float,
) -> None:
    """Correct what is believed by what was measured where ``reached`` was expected."""
    x, P = memory.x, memory.P
    x[_V : _V + 3] = reached.v_WB_W[0]
    _spread(model, P, slopes, duration)
    before = x[_TAU]
    for i in range(3):
        _correct(x, P, i, v_WB_W[i])
    for i in range(3):
        x[_D + i] = min(max(x[_D + i], -_ACCELERATION_BOUND), _ACCELERATION_BOUND)
    x[_K] = min(max(x[_K], SCALE_BOUNDS[0]), SCALE_BOUNDS[1])
    x[_TAU] = _bounded_lag(x[_TAU], model.thrust_time_constant)
    memory.throttle[0] += memory.throttle[1] * (x[_TAU] - before)
    _correct_rate_lag(
        model, memory.rate_lag, reached.actuators[0, 1:], slopes.w_by_lag, w_WB_B, duration
    )


@compiled
def _bounded_lag(time_constant: float, modelled: float) -> float:
    return min(max(time_constant, modelled / _LAG_BOUND), modelled * _LAG_BOUND)


@compiled
def _spread(model: Model, P: Array, slopes: _Slopes, duration: float) -> None:
    """Let the uncertainty grow over a duration."""
    F = np.eye(_SIZE)
    for i in range(3):
        F[i, i] -= duration * model.drag
        F[i, _D + i] = duration
        F[i, _K] = slopes.v_by_scale[i]
        F[i, _TAU] = slopes.v_by_lag[i]
    P[:] = F @ P @ F.T
    for i in range(3):
        P[i, i] += _ACCELERATION_NOISE**2 * duration
        P[_D + i, _D + i] += _ACCELERATION_WALK**2 * duration
    P[_K, _K] += _SCALE_WALK**2 * duration
    P[_TAU, _TAU] += (_LAG_WALK * model.thrust_time_constant) ** 2 * duration


@compiled
def _correct(x: Array, P: Array, entry: int, measured: float) -> None:
    """Take a measurement of one entry of the state."""
    gain = P[entry] / (P[entry, entry] + _VELOCITY_NOISE**2)
    row = P[entry].copy()
    x += gain * (measured - x[entry])
    for i in range(_SIZE):
        for j in range(_SIZE):
            P[i, j] -= gain[i] * row[j]


@compiled
def _correct_rate_lag(
    model: Model,
    rate_lag: Array,
    expected: Array,
    slopes: Array,
    measured: Array,
    duration: float,
) -> None:
    """Take the measured rates of the three axes, one after another."""
    if model.rate_time_constant <= 0.0:
        return
    time_constant, variance = rate_lag[0], rate_lag[1]
    before = time_constant
    variance += (_LAG_WALK * model.rate_time_constant) ** 2 * duration
    for i in range(3):
        gain = variance * slopes[i] / (slopes[i] ** 2 * variance + _RATE_NOISE**2)
        off = measured[i] - expected[i] - slopes[i] * (time_constant - before)
        time_constant += gain * off
        variance -= gain * slopes[i] * variance
    rate_lag[0] = _bounded_lag(time_constant, model.rate_time_constant)
    rate_lag[1] = variance
