"""The process model of the disturbance EKF: velocity and throttle under the acting commands.

Between two odometries the vehicle is rolled forward by what is estimated of it, and with it the
derivatives of the velocity by what is learned: by the thrust's scale k, its time constant, and the
mean mu of the drag,

    dv/dk = sum of dt T(s)/m z_B,   dv/dtau_s = sum of dt k T'(s)/m ds/dtau_s z_B,
    dv/dmu = -dt R S R' v,          S = D/mean(D)

with z_B the mean thrust axis of the time between.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import (
    actuators_in,
    first_order_lag,
    first_order_lag_slopes,
)
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rollout import Body, propagated

# Longest stretch predicted at once [s].
_LONGEST = 0.0025


class Throttle(NamedTuple):
    """The throttle that nobody measures, and its derivative by the thrust's time constant."""

    value: float
    slope: float


class MotionPrediction(NamedTuple):
    """Where the commands lead: state, throttle, and derivatives of the velocity."""

    body: Body
    throttle: Throttle
    v_by_scale: kernels.Vector
    v_by_lag: kernels.Vector
    v_by_drag: kernels.Vector


@compiled
def predict(
    estimated: ModelParameters,
    commands: Array,
    durations: Array,
    throttle: Throttle,
    start: Body,
    R_after: kernels.Matrix,
) -> MotionPrediction:
    """Move a state on through commands (n, 4), each for one of the durations (n,) [s].

    ``R_after`` is the attitude measured at the end, for the mean thrust axis.
    """
    axis = _mean_axis(kernels.column(start.R, 2), kernels.column(R_after, 2))
    value, slope = throttle.value, throttle.slope
    body, v_by_scale, v_by_lag = start, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(len(durations)):
        dt, command = durations[k], actuators_in(commands[k])
        decay, share = first_order_lag(estimated.thrust_time_constant, dt)
        decay_slope, share_slope = first_order_lag_slopes(estimated.thrust_time_constant, dt)
        off = value - command[0]
        mean, mean_slope = command[0] + share * off, share * slope + share_slope * off
        value, slope = command[0] + decay * off, decay * slope + decay_slope * off
        push = dt * ((estimated.a * mean + estimated.b) * mean + estimated.c)
        push_slope = (
            dt * estimated.thrust_scale * (2.0 * estimated.a * mean + estimated.b) * mean_slope
        )
        v_by_scale = kernels.plus(v_by_scale, kernels.scaled(push, axis))
        v_by_lag = kernels.plus(v_by_lag, kernels.scaled(push_slope, axis))
        body = propagated(estimated, command, dt, _LONGEST, body)
    shape, half = _drag_shape(estimated), -0.5 * durations.sum()
    v_by_drag = kernels.plus(
        kernels.scaled(half, _slowing(shape, start.R, start.v)),
        kernels.scaled(half, _slowing(shape, R_after, body.v)),
    )
    return MotionPrediction(body, Throttle(value, slope), v_by_scale, v_by_lag, v_by_drag)


@compiled
def _slowing(shape: kernels.Vector, R_WB: kernels.Matrix, v: kernels.Vector) -> kernels.Vector:
    """Return R S R' v, what a drag of 1 1/s on average takes of a velocity per second."""
    u = kernels.apply_transposed(R_WB, v)
    return kernels.apply(R_WB, (shape[0] * u[0], shape[1] * u[1], shape[2] * u[2]))


@compiled
def _drag_shape(modelled: ModelParameters) -> kernels.Vector:
    """Return the drag along each axis of the body over their mean, alike where there is none."""
    mean, off = modelled.drag, kernels.vector(modelled.uneven_drag)
    if mean <= 0.0:
        return 1.0, 1.0, 1.0
    return 1.0 + off[0] / mean, 1.0 + off[1] / mean, 1.0 + off[2] / mean


@compiled
def _mean_axis(before: kernels.Vector, after: kernels.Vector) -> kernels.Vector:
    """Return the mean of a direction that turned evenly from one to another (Simpson)."""
    middle = kernels.plus(before, after)
    length = math.sqrt(kernels.dot(middle, middle))
    if length < 1e-6:
        return after
    return kernels.scaled(1.0 / 6.0, kernels.plus(middle, kernels.scaled(4.0 / length, middle)))
