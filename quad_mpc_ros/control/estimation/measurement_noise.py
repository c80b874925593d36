# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimation of the measurement noise of position and velocity, which few odometry sources report.

**White noise** of one measurement appears in two successive changes with opposite signs,
unmodelled motion with the same sign. With y_k the measured minus the predicted change between two
odometries, white noise of variance s^2 gives

    y_k - y_{k-1} = n_k - 2 n_{k-1} + n_{k-2},   variance 6 s^2 along each axis,

and errors that last longer than two odometries cancel.

**Drift of the velocity**, as of autopilots' estimators, appears as a difference between the change
of the position and the integral of the velocity over a window W,

    e <- exp(-dt / W) e + (dp - v dt),   variance about s_p^2 + W^2 s_b^2,

with the white noise s_p of the position and the standard deviation s_b of the drift. Initially the
window is as long as the elapsed time.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, kernels


class WhiteNoise(Record):
    """White noise of one measurement."""

    variance: float
    has_previous: int  # whether there is a previous change
    change: Vector3  # previous measured less predicted change
    least: float  # lower bound of the variance
    age: float  # s, duration of the estimation


class VelocityDrift(Record):
    """Drift of the velocity."""

    square: float  # m^2, mean of e beyond white noise
    window: float  # s^2, mean of the window
    p_WB: Vector3  # m, measured last
    v_WB_W: Vector3  # m/s, measured last
    off: Vector3  # m, e
    age: float  # s


USUAL = 0.05
"""Lower bound of the velocity noise with the default bandwidth [m/s]."""
LEAST_OF_POSITION = 0.01  # m, lower bound of the position noise
_MIN_DRIFT = 0.02  # m/s
INITIAL = 0.1
"""Noise before it is estimated [m/s or m]."""
MOST = 1.0
"""Upper bound of position noise [m], velocity noise [m/s] and velocity drift [m/s]."""
_AVERAGING_TIME = 2.0  # s
_MAX_RATIO = 9.0  # of an observation to the variance, as a jump is not noise
_DRIFT_WINDOW = 0.3  # s


@compiled
def variance_in(noise: WhiteNoise) -> float:
    """Return the variance along an axis, within bounds."""
    return kernels.clamp(noise.variance, noise.least, MOST**2)


@compiled
def drift_variance_in(drift: VelocityDrift, reported: float) -> float:
    """Return the variance of the drift [m^2/s^2], at least ``reported``."""
    return kernels.clamp(max(drift.square / drift.window, reported), _MIN_DRIFT**2, MOST**2)


@compiled
def update_white_noise(noise: WhiteNoise, change: kernels.Vector, duration: float) -> None:
    """Update with the next measured minus predicted change, after a duration."""
    square = 0.0
    for i in range(3):
        square += (change[i] - noise.change[i]) ** 2
        noise.change[i] = change[i]
    if noise.has_previous:
        observed = min(square / 18.0, _MAX_RATIO * variance_in(noise))
        noise.age += duration
        noise.variance += _share(noise.age, duration) * (observed - noise.variance)
    noise.has_previous = 1


@compiled
def update_drift(
    drift: VelocityDrift, p_WB: Array, v_WB_W: Array, white: float, duration: float
) -> None:
    """Update with measured position (3,) [m] and velocity (3,) [m/s] after a duration [s].

    ``white`` [m^2] is the variance of the position.
    """
    square, kept = 0.0, math.exp(-duration / _DRIFT_WINDOW)
    for k in range(3):
        moved = p_WB[k] - drift.p_WB[k]
        predicted = 0.5 * duration * (v_WB_W[k] + drift.v_WB_W[k])
        drift.off[k] = kept * drift.off[k] + moved - predicted
        square += drift.off[k] ** 2
    drift.age += duration
    window = _DRIFT_WINDOW * -math.expm1(-drift.age / _DRIFT_WINDOW)
    largest = _MAX_RATIO * (drift_variance_in(drift, 0.0) * window**2 + white)
    observed, share = max(min(square / 3.0, largest) - white, 0.0), duration / _AVERAGING_TIME
    drift.square += share * (observed - drift.square)
    drift.window += share * (window**2 - drift.window)
    begin_drift(drift, p_WB, v_WB_W)


@compiled
def begin_drift(drift: VelocityDrift, p_WB: Array, v_WB_W: Array) -> None:
    """Set the previous position (3,) [m] and velocity (3,) [m/s]."""
    drift.p_WB[:] = p_WB
    drift.v_WB_W[:] = v_WB_W


@compiled
def _share(age: float, duration: float) -> float:
    """Return the weight of the newest observation in the mean of all or recent observations."""
    return (
        duration / age
        if age < _AVERAGING_TIME
        else kernels.lowpass_share(duration, _AVERAGING_TIME)
    )


def start(noise: WhiteNoise, least: float) -> None:
    """Write the initial noise; its standard deviation is at least ``least``."""
    noise.variance, noise.least = INITIAL**2, least**2


def start_drift(drift: VelocityDrift) -> None:
    """Write the initial drift, as of a window of 0.1 s."""
    drift.window = INITIAL**2
    drift.square = INITIAL**2 * drift.window
