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
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.estimation.command_history import Acting
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.rollout import Body, Disturbance, Model, input_at, moved_on

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
# the thrust is the weight, up to its scale. With less than the last of these and the largest scale
# it would fall, and be at rest no longer before _TOUCHDOWN [s] has passed: so it has landed.
_REST_SPEED, _LIFT, _LANDED = 0.1, 0.95, 0.6
_TOUCHDOWN = 0.25


class Memory(NamedTuple):
    """``x`` (8,) and ``P`` (8, 8) of the velocity's filter; ``throttle`` (2,) with its derivative
    by the time constant; ``rate_lag`` (2,): time constant of the rates and its variance; ``flown``
    (1,): one in flight, zero on the ground, between them while it seems to have landed.
    """

    x: Array
    P: Array
    throttle: Array
    rate_lag: Array
    flown: Array


class _Slopes(NamedTuple):
    """How an interval changes: by the thrust's scale and by the time constants.

    ``v_by_scale`` and ``v_by_lag`` of the velocity, ``w_by_lag`` of the rates.
    """

    v_by_scale: kernels.Vector
    v_by_lag: kernels.Vector
    w_by_lag: kernels.Vector


class VehicleEstimator:
    """Follows a vehicle from odometry to odometry; without ``learning`` only its throttle."""

    def __init__(self, model: Model, *, throttle: float, learning: bool) -> None:
        self._modelled = model
        self._learning = learning
        self._throttle = throttle
        self._lagging = model.thrust_time_constant > 0.0 or model.rate_time_constant > 0.0
        self._memory = Memory(
            x=np.zeros(_SIZE),
            P=np.zeros((_SIZE, _SIZE)),
            throttle=np.zeros(2),
            rate_lag=np.array(
                (model.rate_time_constant, (_LAG_SPREAD * model.rate_time_constant) ** 2)
            ),
            flown=np.zeros(1),
        )
        x, P = self._memory.x, self._memory.P
        x[_K], x[_TAU] = 1.0, model.thrust_time_constant
        P[_D : _D + 3, _D : _D + 3] = np.eye(3) * _ACCELERATION_SPREAD**2
        P[_K, _K] = _SCALE_SPREAD**2
        P[_TAU, _TAU] = (_LAG_SPREAD * model.thrust_time_constant) ** 2
        self.begin()

    @property
    def memory(self) -> Memory:
        """What it knows, for :func:`start_at` and :func:`follow`."""
        return self._memory

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
        if not self._lagging:
            return self._modelled
        return self._modelled._replace(
            thrust_time_constant=float(self._memory.x[_TAU]),
            rate_time_constant=float(self._memory.rate_lag[0]),
        )

    def begin(self) -> None:
        """Suppose the vehicle perhaps on the ground, and keep what was learned."""
        self._memory.throttle[:] = self._throttle, 0.0
        self._memory.flown[0] = 0.0

    def start(self, v_WB_W: Array) -> None:
        """Begin, and believe a velocity (3,)."""
        self.begin()
        start_at(self._memory.x, self._memory.P, v_WB_W)

    def follow(
        self,
        *,
        R_before: Array,
        w_before: Array,
        R_after: Array,
        w_after: Array,
        v_after: Array,
        acting: Acting,
        frozen: bool,
    ) -> None:
        """Go on from one odometry to the next, under the commands that acted between them.

        Attitudes (3, 3) and body rates (3,) are those of the two, ``v_after`` (3,) is the second's
        velocity in the world. ``frozen`` learns nothing.
        """
        follow(
            self._modelled,
            self._memory,
            acting.durations,
            acting.commands,
            R_before,
            w_before,
            R_after,
            w_after,
            v_after,
            self._learning,
            frozen,
        )


@compiled
def follow(
    modelled: Model,
    memory: Memory,
    durations: Array,
    commands: Array,
    R_before: Array,
    w_before: Array,
    R_after: Array,
    w_after: Array,
    v_after: Array,
    learning: bool,
    frozen: bool,
) -> None:
    """Follow a vehicle from one odometry to the next, and learn of it."""
    if len(durations) == 0:
        return
    x, P, flown = memory.x, memory.P, memory.flown
    believed = Model(
        modelled.a,
        modelled.b,
        modelled.c,
        modelled.drag,
        modelled.gravity,
        x[_TAU],
        memory.rate_lag[0],
    )
    axis = _mean_axis(
        kernels.column(kernels.matrix(R_before), 2), kernels.column(kernels.matrix(R_after), 2)
    )
    start = Body(
        (0.0, 0.0, 0.0),
        kernels.vector(x[_V : _V + 3]),
        kernels.matrix(R_before),
        (memory.throttle[0], w_before[0], w_before[1], w_before[2]),
    )
    reached, slopes = _followed(believed, memory, commands, durations, axis, start)
    if not learning:
        return
    duration = durations.sum()
    thrust = slopes.v_by_scale[2] / duration
    v = kernels.vector(v_after)
    resting = kernels.dot(v, v) < _REST_SPEED**2
    if not resting or thrust > _LIFT * modelled.gravity:
        flown[0] = 1.0
    elif thrust < _LANDED * modelled.gravity:
        flown[0] = max(flown[0] - duration / _TOUCHDOWN, 0.0)
    elif flown[0] > 0.0:
        flown[0] = 1.0
    if frozen or flown[0] < 1.0:
        start_at(x, P, v_after)
    else:
        _learn(modelled, memory, slopes, reached, v_after, w_after, duration)


@compiled
def _mean_axis(before: kernels.Vector, after: kernels.Vector) -> kernels.Vector:
    """Return the mean of a direction that turned evenly from one to another (Simpson)."""
    middle = kernels.plus(before, after)
    length = math.sqrt(kernels.dot(middle, middle))
    if length < 1e-6:
        return after
    return kernels.scaled(1.0 / 6.0, kernels.plus(middle, kernels.scaled(4.0 / length, middle)))


@compiled
def start_at(x: Array, P: Array, v_WB_W: Array) -> None:
    """Believe a velocity (3,), and keep what was learned."""
    for i in range(3):
        x[i] = v_WB_W[i]
        P[i, :] = 0.0
        P[:, i] = 0.0
        P[i, i] = _VELOCITY_NOISE**2


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
    memory: Memory,
    commands: Array,
    durations: Array,
    thrust_axis_W: kernels.Vector,
    start: Body,
) -> tuple[Body, _Slopes]:
    """Move a state on through commands (n, 4) by what is believed; return it and its slopes."""
    x, body, d_W = memory.x, start, kernels.vector(memory.x[_D : _D + 3])
    throttle, slope = memory.throttle[0], memory.throttle[1]
    v_by_scale = v_by_lag = w_by_lag = (0.0, 0.0, 0.0)
    for k in range(len(durations)):
        dt, command = durations[k], input_at(commands[k])
        decay, share, decay_slope, share_slope = _lag_slopes(model.rate_time_constant, dt)
        excess = (
            body.actuators[1] - command[1],
            body.actuators[2] - command[2],
            body.actuators[3] - command[3],
        )
        w_by_lag = kernels.plus(
            kernels.scaled(decay, w_by_lag), kernels.scaled(decay_slope, excess)
        )
        decay, share, decay_slope, share_slope = _lag_slopes(model.thrust_time_constant, dt)
        off = throttle - command[0]
        mean, mean_slope = command[0] + share * off, share * slope + share_slope * off
        throttle, slope = command[0] + decay * off, decay * slope + decay_slope * off
        push = dt * ((model.a * mean + model.b) * mean + model.c)
        push_slope = dt * x[_K] * (2.0 * model.a * mean + model.b) * mean_slope
        v_by_scale = kernels.plus(v_by_scale, kernels.scaled(push, thrust_axis_W))
        v_by_lag = kernels.plus(v_by_lag, kernels.scaled(push_slope, thrust_axis_W))
        body = moved_on(model, d_W, x[_K], command, dt, _LONGEST, body)
    memory.throttle[0], memory.throttle[1] = throttle, slope
    return body, _Slopes(v_by_scale, v_by_lag, w_by_lag)


@compiled
def _learn(
    model: Model,
    memory: Memory,
    slopes: _Slopes,
    reached: Body,
    v_WB_W: Array,
    w_WB_B: Array,
    duration: float,
) -> None:
    """Correct what is believed by what was measured where ``reached`` was expected."""
    x, P = memory.x, memory.P
    kernels.store_vector(reached.v, x[_V : _V + 3])
    _spread(model, P, slopes, duration)
    before = x[_TAU]
    for i in range(3):
        _correct(x, P, i, v_WB_W[i])
    for i in range(3):
        x[_D + i] = kernels.clamp(x[_D + i], -_ACCELERATION_BOUND, _ACCELERATION_BOUND)
    x[_K] = kernels.clamp(x[_K], SCALE_BOUNDS[0], SCALE_BOUNDS[1])
    x[_TAU] = _bounded_lag(x[_TAU], model.thrust_time_constant)
    memory.throttle[0] += memory.throttle[1] * (x[_TAU] - before)
    _correct_rate_lag(
        model, memory.rate_lag, reached.actuators[1:], slopes.w_by_lag, w_WB_B, duration
    )


@compiled
def _bounded_lag(time_constant: float, modelled: float) -> float:
    return kernels.clamp(time_constant, modelled / _LAG_BOUND, modelled * _LAG_BOUND)


@compiled
def _spread(model: Model, P: Array, slopes: _Slopes, duration: float) -> None:
    """Let the uncertainty grow over a duration."""
    # F P F', where F differs from one in the rows of the velocity alone.
    kept = 1.0 - duration * model.drag
    for i in range(3):
        by_scale, by_lag = slopes.v_by_scale[i], slopes.v_by_lag[i]
        for j in range(_SIZE):
            others = duration * P[_D + i, j] + by_scale * P[_K, j] + by_lag * P[_TAU, j]
            P[i, j] = kept * P[i, j] + others
    for i in range(3):
        by_scale, by_lag = slopes.v_by_scale[i], slopes.v_by_lag[i]
        for j in range(_SIZE):
            others = duration * P[j, _D + i] + by_scale * P[j, _K] + by_lag * P[j, _TAU]
            P[j, i] = kept * P[j, i] + others
    for i in range(3):
        P[i, i] += _ACCELERATION_NOISE**2 * duration
        P[_D + i, _D + i] += _ACCELERATION_WALK**2 * duration
    P[_K, _K] += _SCALE_WALK**2 * duration
    P[_TAU, _TAU] += (_LAG_WALK * model.thrust_time_constant) ** 2 * duration


@compiled
def _correct(x: Array, P: Array, entry: int, measured: float) -> None:
    """Take a measurement of one entry of the state."""
    row = P[entry].copy()
    variance = row[entry] + _VELOCITY_NOISE**2
    off = measured - x[entry]
    for i in range(_SIZE):
        gain = row[i] / variance
        x[i] += gain * off
        for j in range(_SIZE):
            P[i, j] -= gain * row[j]


@compiled
def _correct_rate_lag(
    model: Model,
    rate_lag: Array,
    expected: kernels.Vector,
    slopes: kernels.Vector,
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
