"""The time constants of the body rates, learned from how they follow their commands.

Roll and pitch share one, their mean, and keep their ratio; yaw has its own: it is turned by the
drag of the rotors, several times slower as a rule, and would pull the others' to its side.

A rate loop is no first-order lag, only like one as long as commands change slowly: at first it
hardly answers, and commands that follow the noise of a velocity ask for little else. So it is not
asked what a rate does within one period, but whether a model that runs beside the vehicle, and is
led to the measured rates slowly only, stays with it,

    w <- c + exp(-t / tau) (w - c),   w <- w + l (measured - w),   l = 1 - exp(-t / 0.3 s)

with the derivative of w by tau beside it. By that derivative a filter of one state for each tau
learns from measured - w, both low-passed alike, for slow motions are what the horizon is of.
"""

from __future__ import annotations

import math
from typing import Annotated

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag, first_order_lag_slopes
from quad_mpc_ros.control.model.parameters import ModelParameters

# Of what the axes share: the mean of roll and pitch, and yaw.
_ROLL_PITCH, _YAW = 0, 1
Pair = Annotated[Array, (2,)]


class RateLagEstimate(Record):
    """The time constants [s] and their variances, of roll and pitch and of yaw."""

    tau: Pair
    variance: Pair


class RateLags(Record):
    """What is known of the lags."""

    estimate: RateLagEstimate
    rate: Vector3  # rad/s, of the model
    slope: Vector3  # its derivative by tau
    # measured - modelled rate and that derivative, low-passed.
    off: Vector3
    off_slope: Vector3
    # As configured: the time constants, by which factor they may be longer, and what each axis
    # has of the time constant that it shares.
    nominal: Pair
    slowest: Pair
    shares: Vector3


_SPREAD = 0.5  # of a time constant at the start, relative
_WALK = 0.1  # relative, 1 / sqrt(s)
_NOISE = 0.1  # rad/s, of a measured rate against the model
_LEADING, _SMOOTHING = 0.3, 0.1  # s
_FASTEST, _SLOWEST_YAW = 0.5, 6.0  # bounds, as factors on what is configured


def start(lags: RateLags, nominal: ModelParameters, *, slower: float = 1.0) -> None:
    """Write the lags at the start, by the configured parameters.

    By ``slower`` of it the time constant of roll and pitch may be longer than configured. A lag of
    zero is none and stays.
    """
    roll, pitch, yaw = nominal.rate_time_constants.tolist()
    shared = 0.5 * (roll + pitch)
    lags.nominal[:] = shared, yaw
    lags.slowest[:] = 1.0 + slower, _SLOWEST_YAW
    lags.shares[:] = roll / (shared or 1.0), pitch / (shared or 1.0), yaw / (yaw or 1.0)
    reset(lags)


def reset(lags: RateLags) -> None:
    """Return to the configured time constants, with the variance of the start."""
    lags.estimate.tau[:] = lags.nominal
    lags.estimate.variance[:] = (_SPREAD * lags.nominal) ** 2


@compiled
def time_constants(lags: RateLags) -> kernels.Vector:
    """Return the time constants of roll, pitch and yaw [s]."""
    shares, tau = lags.shares, lags.estimate.tau
    return shares[0] * tau[_ROLL_PITCH], shares[1] * tau[_ROLL_PITCH], shares[2] * tau[_YAW]


@compiled
def follow(
    lags: RateLags,
    commands: Array,
    durations: Array,
    measured: Array,
    learns: bool,
    follows: bool,
) -> None:
    """Go on to measured rates (3,), under the commands (n, 4) that acted since those before.

    Each did for one of the ``durations`` (n,) [s]. Without ``learns`` the time constants stay;
    what comes before it ``follows`` is forgotten.
    """
    if not max(lags.nominal[_ROLL_PITCH], lags.nominal[_YAW]) > 0.0:
        return
    duration = durations.sum()
    lead = 1.0 - math.exp(-duration / _LEADING) if follows else 1.0
    smoothed = 1.0 - math.exp(-duration / _SMOOTHING)
    for axis in range(3):
        group = _YAW if axis == 2 else _ROLL_PITCH
        share = lags.shares[axis]
        for k in range(len(durations)):
            tau = share * lags.estimate.tau[group]
            _follow(lags, axis, tau, commands[k, 1 + axis], durations[k])
        off, slope = measured[axis] - lags.rate[axis], lags.slope[axis]
        lags.off[axis] += smoothed * (off - lags.off[axis])
        lags.off_slope[axis] += smoothed * (slope - lags.off_slope[axis])
        lags.rate[axis] += lead * off
        lags.slope[axis] = (1.0 - lead) * slope
        if not follows:
            lags.off[axis] = lags.off_slope[axis] = 0.0
        elif learns:
            nominal = lags.nominal[group]
            lags.estimate.variance[group] += _walked(axis, nominal) * duration
            bounds = _FASTEST * nominal, lags.slowest[group] * nominal
            _correct(lags, group, axis, bounds)


@compiled
def _walked(axis: int, nominal: float) -> float:
    """Return the growth of a variance per second, for each of the axes that share it."""
    return (_WALK * nominal) ** 2 * (1.0 if axis == 2 else 0.5)


@compiled
def _follow(lags: RateLags, axis: int, lag: float, command: float, duration: float) -> None:
    """Move the model of an axis on under a command."""
    decay, _share = first_order_lag(lag, duration)
    decay_slope, _share_slope = first_order_lag_slopes(lag, duration)
    off = lags.rate[axis] - command
    lags.slope[axis] = decay * lags.slope[axis] + decay_slope * off
    lags.rate[axis] = command + decay * off


@compiled
def _correct(lags: RateLags, group: int, axis: int, bounds: tuple[float, float]) -> None:
    """Correct a time constant by what an axis with a share in it is off, and with it the model."""
    tau, share = lags.estimate.tau, lags.shares[axis]
    variance, before = lags.estimate.variance[group], tau[group]
    slope = share * lags.off_slope[axis]
    gain = variance * slope / (slope**2 * variance + _NOISE**2)
    tau[group] = kernels.clamp(before + gain * lags.off[axis], bounds[0], bounds[1])
    lags.estimate.variance[group] = variance - gain * slope * variance
    change = tau[group] - before
    lags.off[axis] -= slope * change
    lags.rate[axis] += share * lags.slope[axis] * change
