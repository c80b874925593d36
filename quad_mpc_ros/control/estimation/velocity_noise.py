"""How noisy the measured velocity is: found from the measurements, for few sources say it.

Noise of one measurement shows in two changes of the velocity, with opposite signs; an acceleration
that the model lacks shows in both alike. So with y_k the change from one odometry to the next less
the change predicted, white noise of variance s^2 gives the difference of two of them

    y_k - y_{k-1} = n_k - 2 n_{k-1} + n_{k-2},   variance 6 s^2 along each axis,

and whatever lasts longer than two odometries cancels.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels

# A vector of the variance [m^2/s^2], whether there was a change before, that change, the least
# variance that is believed, and for how long it has been followed [s].
_VARIANCE, _KNOWN, _CHANGE, _LEAST, _AGE, SIZE = 0, 1, 2, 5, 6, 7

_START, _MOST = 0.1, 1.0  # m/s
USUAL = 0.05
"""The least noise of a velocity that is believed of any vehicle [m/s]."""
_FORGETTING, _FIRST = 2.0, 0.05  # s; what is believed at the start is soon forgotten
_LARGEST = 9.0  # of the variance: a jump is no noise, and noise that rises is found in a second


def begun(least: float = USUAL) -> Array:
    """Return what is believed of the noise at the start; it is ``least`` [m/s] or more."""
    noise = np.zeros(SIZE)
    noise[_VARIANCE], noise[_LEAST] = _START**2, least**2
    return noise


@compiled
def variance_in(noise: Array) -> float:
    """Return the variance of a velocity along an axis [m^2/s^2], within bounds."""
    return kernels.clamp(noise[_VARIANCE], noise[_LEAST], _MOST**2)


@compiled
def interrupt(noise: Array) -> None:
    """Forget the last change: what was between is not known."""
    noise[_KNOWN] = 0.0


@compiled
def follow(noise: Array, change: kernels.Vector, duration: float) -> None:
    """Learn from the next change of the velocity that was not predicted, after a duration."""
    square = 0.0
    for i in range(3):
        square += (change[i] - noise[_CHANGE + i]) ** 2
        noise[_CHANGE + i] = change[i]
    if noise[_KNOWN] > 0.0:
        seen = min(square / 18.0, _LARGEST * variance_in(noise))
        noise[_AGE] += duration
        share = 1.0 - math.exp(-duration / min(_FIRST + noise[_AGE], _FORGETTING))
        noise[_VARIANCE] += share * (seen - noise[_VARIANCE])
    noise[_KNOWN] = 1.0
