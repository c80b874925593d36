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

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag, first_order_lag_slopes
from quad_mpc_ros.control.model.parameters import RATE_TIME_CONSTANTS

# One vector: time constants and variances of roll and pitch, of yaw; the model's rates, their
# derivatives; how far they are off and the derivatives, low-passed.
_ROLL_PITCH, _YAW, _RATE, _SLOPE, _OFF, _OFF_SLOPE = 0, 2, 4, 7, 10, 13
_VARIANCE = 1  # beside its time constant
BELIEVED = slice(0, _RATE)
# Then what is configured: those time constants, how much longer they may be, as factors; and what
# each axis has of the time constant that it shares.
_NOMINAL, _SLOWEST, _SHARES, SIZE = 16, 18, 20, 23

_SPREAD = 0.5  # of a time constant at the start, relative
_WALK = 0.1  # relative, 1 / sqrt(s)
_NOISE = 0.1  # rad/s, of a measured rate against the model
_LEADING, _SMOOTHING = 0.3, 0.1  # s
_FASTEST, _SLOWEST_YAW = 0.5, 6.0  # bounds, as factors on what is configured


def begun(nominal: Array, *, slower: float = 1.0) -> Array:
    """Return what is believed at the start (23,), by the configured parameters (29,).

    By ``slower`` of it the time constant of roll and pitch may be longer than configured. A lag of
    zero is none and stays.
    """
    roll, pitch, yaw = nominal[RATE_TIME_CONSTANTS].tolist()
    shared = 0.5 * (roll + pitch)
    lags = np.zeros(SIZE)
    lags[_NOMINAL:_SLOWEST] = shared, yaw
    lags[_SLOWEST:_SHARES] = 1.0 + slower, _SLOWEST_YAW
    lags[_SHARES:SIZE] = roll / (shared or 1.0), pitch / (shared or 1.0), yaw / (yaw or 1.0)
    reset(lags)
    return lags


def reset(lags: Array) -> None:
    """Believe the configured time constants again, and that loosely."""
    for group, place in enumerate((_ROLL_PITCH, _YAW)):
        nominal = lags[_NOMINAL + group]
        lags[place] = nominal
        lags[place + _VARIANCE] = (_SPREAD * nominal) ** 2


@compiled
def time_constants(lags: Array) -> kernels.Vector:
    """Return the time constants of roll, pitch and yaw [s]."""
    shared = lags[_ROLL_PITCH]
    return lags[_SHARES] * shared, lags[_SHARES + 1] * shared, lags[_SHARES + 2] * lags[_YAW]


@compiled
def follow(
    lags: Array, commands: Array, durations: Array, measured: Array, learns: bool, follows: bool
) -> None:
    """Go on to measured rates (3,), under the commands (n, 4) that acted since those before.

    Each did for one of the ``durations`` (n,) [s]. Without ``learns`` the time constants stay;
    what comes before it ``follows`` is forgotten.
    """
    if not max(lags[_NOMINAL], lags[_NOMINAL + 1]) > 0.0:
        return
    duration = durations.sum()
    lead = 1.0 - math.exp(-duration / _LEADING) if follows else 1.0
    smoothed = 1.0 - math.exp(-duration / _SMOOTHING)
    for axis in range(3):
        place, group = (_YAW, 1) if axis == 2 else (_ROLL_PITCH, 0)
        share = lags[_SHARES + axis]
        for k in range(len(durations)):
            _follow(lags, axis, share * lags[place], commands[k, 1 + axis], durations[k])
        off, slope = measured[axis] - lags[_RATE + axis], lags[_SLOPE + axis]
        lags[_OFF + axis] += smoothed * (off - lags[_OFF + axis])
        lags[_OFF_SLOPE + axis] += smoothed * (slope - lags[_OFF_SLOPE + axis])
        lags[_RATE + axis] += lead * off
        lags[_SLOPE + axis] = (1.0 - lead) * slope
        if not follows:
            lags[_OFF + axis] = lags[_OFF_SLOPE + axis] = 0.0
        elif learns:
            nominal = lags[_NOMINAL + group]
            lags[place + _VARIANCE] += _walked(axis, nominal) * duration
            bounds = _FASTEST * nominal, lags[_SLOWEST + group] * nominal
            _correct(lags, place, axis, share, bounds)


@compiled
def _walked(axis: int, nominal: float) -> float:
    """Return the growth of a variance per second, for each of the axes that share it."""
    return (_WALK * nominal) ** 2 * (1.0 if axis == 2 else 0.5)


@compiled
def _follow(lags: Array, axis: int, lag: float, command: float, duration: float) -> None:
    """Move the model of an axis on under a command."""
    decay, _share = first_order_lag(lag, duration)
    decay_slope, _share_slope = first_order_lag_slopes(lag, duration)
    off = lags[_RATE + axis] - command
    lags[_SLOPE + axis] = decay * lags[_SLOPE + axis] + decay_slope * off
    lags[_RATE + axis] = command + decay * off


@compiled
def _correct(
    lags: Array, place: int, axis: int, share: float, bounds: tuple[float, float]
) -> None:
    """Correct a time constant by what an axis with a share in it is off, and with it the model."""
    variance, before = lags[place + _VARIANCE], lags[place]
    slope = share * lags[_OFF_SLOPE + axis]
    gain = variance * slope / (slope**2 * variance + _NOISE**2)
    lags[place] = kernels.clamp(before + gain * lags[_OFF + axis], bounds[0], bounds[1])
    lags[place + _VARIANCE] = variance - gain * slope * variance
    change = lags[place] - before
    lags[_OFF + axis] -= slope * change
    lags[_RATE + axis] += share * lags[_SLOPE + axis] * change
