"""How noisy the measured velocity is: found from the measurements, for few sources say it.

Noise of one measurement shows in two changes of the velocity, with opposite signs; an acceleration
that the model lacks shows in both alike. So with y_k the change from one odometry to the next less
the change predicted, white noise of variance s^2 gives the difference of two of them

    y_k - y_{k-1} = n_k - 2 n_{k-1} + n_{k-2},   variance 6 s^2 along each axis,

and whatever lasts longer than two odometries cancels.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import kernels


class VelocityNoise(Record):
    """What is known of the noise."""

    variance: float  # m^2/s^2
    known: int  # whether there was a change before
    change: Vector3  # m/s, the change before
    least: float  # m^2/s^2, the least variance
    age: float  # s, for how long it has been estimated


_START, _MOST = 0.1, 1.0  # m/s
USUAL = 0.05
"""The least noise of a velocity that is assumed of any vehicle [m/s]."""
_FORGETTING, _FIRST = 2.0, 0.05  # s; what is assumed at the start is soon forgotten
_LARGEST = 9.0  # of the variance: a jump is no noise, and noise that rises is found in a second


def start(noise: VelocityNoise, least: float = USUAL) -> None:
    """Write the noise at the start; it is ``least`` [m/s] or more."""
    noise.variance, noise.least = _START**2, least**2


@compiled
def variance_in(noise: VelocityNoise) -> float:
    """Return the variance of a velocity along an axis [m^2/s^2], within bounds."""
    return kernels.clamp(noise.variance, noise.least, _MOST**2)


@compiled
def interrupt(noise: VelocityNoise) -> None:
    """Forget the last change: what was between is not known."""
    noise.known = 0


@compiled
def follow(noise: VelocityNoise, change: kernels.Vector, duration: float) -> None:
    """Learn from the next change of the velocity that was not predicted, after a duration."""
    square = 0.0
    for i in range(3):
        square += (change[i] - noise.change[i]) ** 2
        noise.change[i] = change[i]
    if noise.known:
        seen = min(square / 18.0, _LARGEST * variance_in(noise))
        noise.age += duration
        share = 1.0 - math.exp(-duration / min(_FIRST + noise.age, _FORGETTING))
        noise.variance += share * (seen - noise.variance)
    noise.known = 1
