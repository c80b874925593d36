"""The process model of the disturbance EKF: velocity and throttle under the acting commands.

Between two odometries the vehicle is rolled forward by what is believed of it, and with it the
derivatives of the velocity by what is learned: by the thrust's scale k and its time constant,

    dv/dk = sum of dt T(s)/m z_B,   dv/dtau_s = sum of dt k T'(s)/m ds/dtau_s z_B

with z_B the mean thrust axis of the time between.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.actuators import actuators_in, first_order_lag, first_order_lag_slopes
from quad_mpc_ros.model.parameters import ModelParameters
from quad_mpc_ros.model.rollout import Body, propagated

# Longest stretch predicted at once [s].
_LONGEST = 0.0025


class Throttle(NamedTuple):
    """The throttle that nobody measures, and its derivative by the thrust's time constant."""

    value: float
    slope: float


class Prediction(NamedTuple):
    """Where the commands lead: state, throttle, and derivatives of the velocity."""

    body: Body
    throttle: Throttle
    v_by_scale: kernels.Vector
    v_by_lag: kernels.Vector


@compiled
def predict(
    believed: ModelParameters,
    commands: Array,
    durations: Array,
    throttle: Throttle,
    start: Body,
    R_after: kernels.Matrix,
) -> Prediction:
    """Move a state on through commands (n, 4), each for one of the durations (n,) [s].

    ``R_after`` is the attitude measured at the end, for the mean thrust axis.
    """
    axis = _mean_axis(kernels.column(start.R, 2), kernels.column(R_after, 2))
    value, slope = throttle.value, throttle.slope
    body, v_by_scale, v_by_lag = start, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(len(durations)):
        dt, command = durations[k], actuators_in(commands[k])
        decay, share = first_order_lag(believed.thrust_time_constant, dt)
        decay_slope, share_slope = first_order_lag_slopes(believed.thrust_time_constant, dt)
        off = value - command[0]
        mean, mean_slope = command[0] + share * off, share * slope + share_slope * off
        value, slope = command[0] + decay * off, decay * slope + decay_slope * off
        push = dt * ((believed.a * mean + believed.b) * mean + believed.c)
        push_slope = (
            dt * believed.thrust_scale * (2.0 * believed.a * mean + believed.b) * mean_slope
        )
        v_by_scale = kernels.plus(v_by_scale, kernels.scaled(push, axis))
        v_by_lag = kernels.plus(v_by_lag, kernels.scaled(push_slope, axis))
        body = propagated(believed, command, dt, _LONGEST, body)
    return Prediction(body, Throttle(value, slope), v_by_scale, v_by_lag)


@compiled
def _mean_axis(before: kernels.Vector, after: kernels.Vector) -> kernels.Vector:
    """Return the mean of a direction that turned evenly from one to another (Simpson)."""
    middle = kernels.plus(before, after)
    length = math.sqrt(kernels.dot(middle, middle))
    if length < 1e-6:
        return after
    return kernels.scaled(1.0 / 6.0, kernels.plus(middle, kernels.scaled(4.0 / length, middle)))
