"""How noisy position and velocity are: found from the measurements, for few sources say it.

**White noise** of one measurement shows in two changes of it, with opposite signs; a motion that
the model lacks shows in both alike. So with y_k the change from one odometry to the next less the
change predicted, white noise of variance s^2 gives the difference of two of them

    y_k - y_{k-1} = n_k - 2 n_{k-1} + n_{k-2},   variance 6 s^2 along each axis,

and whatever lasts longer than two odometries cancels.

**Errors of the velocity that last**, as those of every autopilot's estimator do, show in how the
position moves: over a window W it moves by the integral of the velocity and no more,

    e <- exp(-dt / W) e + (dp - v dt),   variance about s_p^2 + W^2 s_b^2,

s_p that of the position's white noise, s_b the standard deviation of what lasts; at first the
window is as long as there has been time.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, kernels


class WhiteNoise(Record):
    """What is known of the noise of one measurement."""

    variance: float
    known: int  # whether there was a change before
    change: Vector3  # the change before, beyond the predicted
    least: float  # the least variance
    age: float  # s, for how long it has been estimated


class VelocityDrift(Record):
    """What is known of the velocity's errors that last."""

    square: float  # m^2, mean of e beyond white noise
    window: float  # s^2, mean of the window
    p_WB: Vector3  # m, measured last
    v_WB_W: Vector3  # m/s, measured last
    off: Vector3  # m, e
    age: float  # s


USUAL = 0.05
"""The least noise of a velocity that is assumed of any vehicle [m/s]."""
LEAST_OF_POSITION = 0.01  # m
_LEAST_DRIFT = 0.02  # m/s
_START = 0.1  # m/s or m
MOST = 1.0
"""The most noise of a position [m] or a velocity [m/s], and the most that this errs for long."""
_FORGETTING = 2.0  # s; what is assumed at the start is forgotten at once
_LARGEST = 9.0  # of the variance: a jump is no noise, and noise that rises is found in a second
_WINDOW = 0.3  # s


@compiled
def variance_in(noise: WhiteNoise) -> float:
    """Return the variance along an axis, within bounds."""
    return kernels.clamp(noise.variance, noise.least, MOST**2)


@compiled
def drift_variance_in(drift: VelocityDrift, given: float) -> float:
    """Return the variance of what lasts [m^2/s^2], ``given`` at least."""
    return kernels.clamp(max(drift.square / drift.window, given), _LEAST_DRIFT**2, MOST**2)


@compiled
def follow(noise: WhiteNoise, change: kernels.Vector, duration: float) -> None:
    """Learn from the next change that was not predicted, after a duration."""
    square = 0.0
    for i in range(3):
        square += (change[i] - noise.change[i]) ** 2
        noise.change[i] = change[i]
    if noise.known:
        seen = min(square / 18.0, _LARGEST * variance_in(noise))
        noise.age += duration
        noise.variance += _share(noise.age, duration) * (seen - noise.variance)
    noise.known = 1


@compiled
def follow_drift(
    drift: VelocityDrift, p_WB: Array, v_WB_W: Array, white: float, duration: float
) -> None:
    """Learn from how position (3,) [m] and velocity (3,) [m/s] moved over a duration [s].

    ``white`` [m^2] is the variance of the position.
    """
    square, kept = 0.0, math.exp(-duration / _WINDOW)
    for k in range(3):
        moved = p_WB[k] - drift.p_WB[k]
        led = 0.5 * duration * (v_WB_W[k] + drift.v_WB_W[k])
        drift.off[k] = kept * drift.off[k] + moved - led
        square += drift.off[k] ** 2
    drift.age += duration
    window = _WINDOW * -math.expm1(-drift.age / _WINDOW)
    largest = _LARGEST * (drift_variance_in(drift, 0.0) * window**2 + white)
    seen, share = max(min(square / 3.0, largest) - white, 0.0), duration / _FORGETTING
    drift.square += share * (seen - drift.square)
    drift.window += share * (window**2 - drift.window)
    begin_drift(drift, p_WB, v_WB_W)


@compiled
def begin_drift(drift: VelocityDrift, p_WB: Array, v_WB_W: Array) -> None:
    """Take position (3,) [m] and velocity (3,) [m/s] as those measured last."""
    drift.p_WB[:] = p_WB
    drift.v_WB_W[:] = v_WB_W


@compiled
def _share(age: float, duration: float) -> float:
    """Return the share of what is seen now in the mean of all, later of the last seconds."""
    return duration / age if age < _FORGETTING else kernels.lowpass_share(duration, _FORGETTING)


def start(noise: WhiteNoise, least: float) -> None:
    """Write the noise at the start; its standard deviation is ``least`` or more."""
    noise.variance, noise.least = _START**2, least**2


def start_drift(drift: VelocityDrift) -> None:
    """Write the drift at the start, as seen over a window of 0.1 s."""
    drift.window = _START**2
    drift.square = _START**2 * drift.window
