"""What roll and pitch rate have beyond their commands: a vehicle's trim.

A centre of mass off by r makes a torque m f r about it at a specific thrust f. A rate loop of gain
P [1/s] holds that by an error: about an axis of inertia J the rate is off by m f r / (J P). Its
integral takes this away, in about a second, and only as far as it is allowed to. The torque is of
the same rotors that follow commands, and as late as they are, so in commands the offset is

    o = c + k f(s_c),   k = m r / (J P),

with the thrust that the *commanded* throttle makes by the model, and c for what the integral has
found of it, or what else is there. At 14 mm, 0.75 kg, 2.1 g m^2 and 60 1/s k is 0.083 rad/s per
m/s^2: 0.8 rad/s in a hover. What rates follow is their command and the offset; a plan takes that
off.

As for the lags (:mod:`.rate_lags`) a model runs beside the vehicle and is led to the measured
rates slowly; by its derivatives by c and k a filter estimates them from measured - modelled. **A
vehicle that answers later** than modelled is off as well, by -dw/dt times so much time: a third
state D takes that, which nothing else uses. Without it an offset that follows each oscillation of
a loop with hidden delay takes the loop's margin. The noise of the difference is estimated on the
way: a vehicle that oscillates learns slowly. An offset that is found soon makes a loop that is as
quick, and a vehicle that answers much sooner than configured oscillates by it. So it is learned
only where short lags are configured.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag
from quad_mpc_ros.control.model.parameters import ModelParameters, modelled_thrust

# The state of an axis (c, k, D).
_C, _K, _D, _STATES = 0, 1, 2, 3
_AXES = 2  # roll and pitch
_PerAxis = Annotated[Array, (_AXES,)]


class OffsetEstimate(Record):
    """The states of the axes and their covariances."""

    x: Annotated[Array, (_AXES, _STATES)]
    P: Annotated[Array, (_AXES, _STATES, _STATES)]


class RateOffsets(Record):
    """What is known of the offsets."""

    estimate: OffsetEstimate
    # Of each axis: rate of the model, its derivatives by the state, and its slope.
    rate: _PerAxis
    by: Annotated[Array, (_AXES, _STATES)]
    slope: _PerAxis
    # Mean of what the rate is off, and variance of what D leaves of it.
    mean: _PerAxis
    variance: _PerAxis
    # Of the states: spreads at the start, and walks. With spreads of zero nothing is learned.
    spread: Vector3
    walk: Vector3


# Of c [rad/s], k [rad/s per m/s^2] and D [s]: spread at the start, walk per root of a second.
_SPREADS, _WALKS = (0.3, 0.05, 0.3), (0.12, 0.001, 0.1)
_MOST = 3.0, 0.2
_NOISE, _LASTING = 0.2, 0.1  # rad/s of a measured rate against the model, for s
_LEADING, _KEEPING = 0.3, 1.0  # s


def start(offsets: RateOffsets, nominal: ModelParameters, *, share: float = 1.0) -> None:
    """Write the offsets at the start, by the configured parameters.

    By ``share`` is learned, from 0, nothing, to 1. Without a lag of the rates nothing is.
    """
    if nominal.rate_time_constants.max() <= 0.0:
        share = 0.0
    shares = np.array([share, share, 1.0])
    offsets.spread[:], offsets.walk[:] = shares * _SPREADS, shares * _WALKS
    reset(offsets)


def reset(offsets: RateOffsets) -> None:
    """Return to no offset, with the covariance of the start."""
    offsets.estimate.x[:] = 0.0
    offsets.estimate.P[:] = np.diag(offsets.spread**2)


@compiled
def _learns(offsets: RateOffsets) -> bool:
    """Whether there can be offsets at all."""
    return bool(offsets.spread[_C] > 0.0)


@compiled
def write(offsets: RateOffsets, parameters: ModelParameters) -> None:
    """Write the offsets into the parameters."""
    x = offsets.estimate.x
    for axis in range(_AXES):
        parameters.rate_offset[axis] = x[axis, _C]
        parameters.rate_offset_by_thrust[axis] = x[axis, _K]


@compiled
def add(offsets: RateOffsets, nominal: ModelParameters, command: Array) -> None:
    """Make of a command (4,) what the rates follow, by the configured parameters."""
    if not _learns(offsets):
        return
    x, thrust = offsets.estimate.x, modelled_thrust(nominal, command[0])
    for axis in range(_AXES):
        command[1 + axis] += x[axis, _C] + x[axis, _K] * thrust


@compiled
def follow(
    offsets: RateOffsets,
    nominal: ModelParameters,
    lags: kernels.Vector,
    commands: Array,
    durations: Array,
    measured: Array,
    learns: bool,
    follows: bool,
) -> None:
    """Go on to measured rates (3,), under the commands (n, 4) that acted since those before.

    Each did for one of the ``durations`` (n,) [s]; ``lags`` are the rates' time constants [s],
    ``nominal`` the configured parameters. Without ``learns`` the offsets stay; what comes before
    it ``follows`` is forgotten.
    """
    if len(durations) == 0 or not _learns(offsets):
        return
    duration = durations.sum()
    lead = 1.0 - math.exp(-duration / _LEADING) if follows else 1.0
    for axis in range(_AXES):
        x, by, before = offsets.estimate.x[axis], offsets.by[axis], offsets.rate[axis]
        rate = before
        for i in range(len(durations)):
            thrust = modelled_thrust(nominal, commands[i, 0])
            command = commands[i, 1 + axis] + x[_C] + x[_K] * thrust
            decay, _share = first_order_lag(lags[axis], durations[i])
            rate = command + decay * (rate - command)
            by[_C] = 1.0 + decay * (by[_C] - 1.0)
            by[_K] = thrust + decay * (by[_K] - thrust)
        slope = (rate - before) / duration
        by[_D] -= slope - offsets.slope[axis]
        offsets.slope[axis], offsets.rate[axis] = slope, rate
        if follows and learns:
            _correct(offsets, axis, measured[axis] - rate, duration)
        offsets.rate[axis] += lead * (measured[axis] - offsets.rate[axis])
        for i in range(_STATES):
            by[i] *= 1.0 - lead


@compiled
def _correct(offsets: RateOffsets, axis: int, off: float, duration: float) -> None:
    """Correct the state of an axis by how far its rate is ``off``, and the model's rate."""
    x, P, by = offsets.estimate.x[axis], offsets.estimate.P[axis], offsets.by[axis]
    spread, walk = offsets.spread, offsets.walk
    for i in range(_STATES):
        # What is not observed must not be determined by noise in the end.
        if P[i, i] < spread[i] ** 2:
            P[i, i] += walk[i] ** 2 * duration
    kept = 1.0 - math.exp(-duration / _KEEPING)
    offsets.mean[axis] += kept * (off - offsets.mean[axis])
    innovation = off - by[_D] * x[_D]
    square = (innovation - offsets.mean[axis]) ** 2
    offsets.variance[axis] += kept * (square - offsets.variance[axis])
    total = max(_NOISE**2, offsets.variance[axis]) * _LASTING / duration
    h = np.empty(_STATES)
    for i in range(_STATES):
        h[i] = P[i, 0] * by[0] + P[i, 1] * by[1] + P[i, 2] * by[2]
        total += by[i] * h[i]
    c, k = x[_C], x[_K]
    for i in range(_STATES):
        x[i] += h[i] / total * innovation
        for j in range(_STATES):
            P[i, j] -= h[i] * h[j] / total
    x[_C] = kernels.clamp(x[_C], -_MOST[0], _MOST[0])
    x[_K] = kernels.clamp(x[_K], -_MOST[1], _MOST[1])
    offsets.rate[axis] += by[_C] * (x[_C] - c) + by[_K] * (x[_K] - k)
