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
rates slowly; its derivatives by c and k tell a filter what measured - modelled says of them. **A
vehicle that answers later** than modelled is off as well, by -dw/dt times so much time: a third
state D takes that, which nothing else believes. Without it an offset that follows each swing of a
loop with hidden delay takes the loop's margin. How noisy the difference is, is found on the way:
who swings learns slowly. An offset that is found soon makes a loop that is as quick, and a vehicle
that answers much sooner than it is told to swings by it. So it is learned of those only that are
told to answer soon.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag
from quad_mpc_ros.control.model.parameters import (
    RATE_OFFSET,
    RATE_OFFSET_BY_THRUST,
    RATE_TIME_CONSTANTS,
    modelled_thrust,
)

# A row an axis: the state (c, k, D) and its covariance (3, 3); the model's rate, its derivatives
# by the state and its slope; mean of what the rate is off, and variance of what D leaves of it.
_C, _K, _COVARIANCE, _RATE, _BY, _SLOPE, _MEAN, _VARIANCE, _ROW = 0, 1, 3, 12, 13, 16, 17, 18, 19
_STATES = 3
_AXES = 2  # roll and pitch
# Behind the rows what the states are believed by: spreads at the start, and walks. Of spreads of
# zero nothing is learned.
_SPREAD, _WALK, SIZE = 38, 41, 44

# Of c [rad/s], k [rad/s per m/s^2] and D [s]: spread at the start, walk per root of a second.
_SPREADS, _WALKS = (0.3, 0.05, 0.3), (0.12, 0.001, 0.1)
_MOST = 3.0, 0.2
_NOISE, _LASTING = 0.2, 0.1  # rad/s of a measured rate against the model, for s
_LEADING, _KEEPING = 0.3, 1.0  # s


def begun(nominal: Array, *, share: float = 1.0) -> Array:
    """Return what is believed at the start (44,), by the configured parameters (29,).

    By ``share`` is learned, from 0, nothing, to 1. Without a lag of the rates nothing is.
    """
    if nominal[RATE_TIME_CONSTANTS].max() <= 0.0:
        share = 0.0
    shares = np.array([share, share, 1.0])
    offsets = np.zeros(SIZE)
    offsets[_SPREAD:_WALK], offsets[_WALK:SIZE] = shares * _SPREADS, shares * _WALKS
    reset(offsets)
    return offsets


def reset(offsets: Array) -> None:
    """Believe in no offset again, and that loosely."""
    believed = believed_in(offsets)
    believed[:] = 0.0
    for k in range(_STATES):
        believed[:, _COVARIANCE + (_STATES + 1) * k] = offsets[_SPREAD + k] ** 2


def believed_in(offsets: Array) -> Array:
    """Return what is believed of the vehicle (2, 12), without the rates of now."""
    rows: Array = offsets[:_SPREAD].reshape(_AXES, _ROW)
    return rows[:, :_RATE]


@compiled
def _rows_in(offsets: Array) -> Array:
    """Return the rows of the axes (2, 19)."""
    return offsets[:_SPREAD].reshape((_AXES, _ROW))


@compiled
def _learns(offsets: Array) -> bool:
    """Whether there can be offsets at all."""
    return bool(offsets[_SPREAD] > 0.0)


@compiled
def write(offsets: Array, parameters: Array) -> None:
    """Write the offsets into the parameters (29,)."""
    rows = _rows_in(offsets)
    for axis in range(_AXES):
        parameters[RATE_OFFSET][axis] = rows[axis, _C]
        parameters[RATE_OFFSET_BY_THRUST][axis] = rows[axis, _K]


@compiled
def add(offsets: Array, nominal: Array, commands: Array) -> None:
    """Make of commands (n, 4) what the rates follow, by the configured parameters (29,)."""
    if not _learns(offsets):
        return
    rows = _rows_in(offsets)
    for i in range(len(commands)):
        thrust = modelled_thrust(nominal, commands[i, 0])
        for axis in range(_AXES):
            commands[i, 1 + axis] += rows[axis, _C] + rows[axis, _K] * thrust


@compiled
def follow(
    offsets: Array,
    nominal: Array,
    lags: kernels.Vector,
    commands: Array,
    durations: Array,
    measured: Array,
    learns: bool,
    follows: bool,
) -> None:
    """Go on to measured rates (3,), under the commands (n, 4) that acted since those before.

    Each did for one of the ``durations`` (n,) [s]; ``lags`` are the rates' time constants [s],
    ``nominal`` the configured parameters (29,). Without ``learns`` the offsets stay; what comes
    before it ``follows`` is forgotten.
    """
    if len(durations) == 0 or not _learns(offsets):
        return
    rows = _rows_in(offsets)
    growth = offsets[_SPREAD:_WALK], offsets[_WALK:SIZE]
    duration = durations.sum()
    lead = 1.0 - math.exp(-duration / _LEADING) if follows else 1.0
    for axis in range(_AXES):
        own = rows[axis]
        by, before = own[_BY : _BY + _STATES], own[_RATE]
        for i in range(len(durations)):
            thrust = modelled_thrust(nominal, commands[i, 0])
            command = commands[i, 1 + axis] + own[_C] + own[_K] * thrust
            decay, _share = first_order_lag(lags[axis], durations[i])
            own[_RATE] = command + decay * (own[_RATE] - command)
            by[0] = 1.0 + decay * (by[0] - 1.0)
            by[1] = thrust + decay * (by[1] - thrust)
        slope = (own[_RATE] - before) / duration
        by[2] -= slope - own[_SLOPE]
        own[_SLOPE] = slope
        if follows and learns:
            _correct(own, by, growth, measured[axis] - own[_RATE], duration)
        own[_RATE] += lead * (measured[axis] - own[_RATE])
        for i in range(_STATES):
            by[i] *= 1.0 - lead


@compiled
def _correct(
    own: Array, by: Array, growth: tuple[Array, Array], off: float, duration: float
) -> None:
    """Correct the state of an axis by how far its rate is ``off``, and the model's rate."""
    P = own[_COVARIANCE : _COVARIANCE + _STATES**2].reshape((_STATES, _STATES))
    for i in range(_STATES):
        if P[i, i] < growth[0][i] ** 2:  # what nothing tells is not to be told by noise in the end
            P[i, i] += growth[1][i] ** 2 * duration
    kept = 1.0 - math.exp(-duration / _KEEPING)
    own[_MEAN] += kept * (off - own[_MEAN])
    innovation = off - by[2] * own[2]
    own[_VARIANCE] += kept * ((innovation - own[_MEAN]) ** 2 - own[_VARIANCE])
    total = max(_NOISE**2, own[_VARIANCE]) * _LASTING / duration
    h = np.empty(_STATES)
    for i in range(_STATES):
        h[i] = P[i, 0] * by[0] + P[i, 1] * by[1] + P[i, 2] * by[2]
        total += by[i] * h[i]
    c, k = own[_C], own[_K]
    for i in range(_STATES):
        own[i] += h[i] / total * innovation
        for j in range(_STATES):
            P[i, j] -= h[i] * h[j] / total
    own[_C] = kernels.clamp(own[_C], -_MOST[0], _MOST[0])
    own[_K] = kernels.clamp(own[_K], -_MOST[1], _MOST[1])
    own[_RATE] += by[0] * (own[_C] - c) + by[1] * (own[_K] - k)
