# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Stability margins of the MPC in hover, of the configured weights, lags and delay.

Near hover no bound is active, and the first input of the plan is u = -K x. K follows from the
Riccati recursion over the horizon, separately for each axis of motion. The MPC predicts x over the
delay d through the commands, from which the throttle follows, as it is not measured. Let G(s) =
(s I - A)^-1 B be the response of an axis to an input that is held for a control period, and M
select the measured states. The loop, opened at the input, is then

    L = D / (1 + S - D),    S = K G,    D = K e^(A d) M G e^(-s d).

Learning is not part of it: the estimator attributes an unmodelled delay to the lags, which raises
the margins.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.config import LEAST_RATE_WEIGHT, MpcConfig
from quad_mpc_ros.control.lie import Array

_FREQUENCIES = np.geomspace(0.3, 150.0, 300)  # rad/s
_SHORTEST_LAG = 1e-3  # s
_CHANGE = 0.01  # of the throttle, for the slope of the thrust


class StabilityMargins(NamedTuple):
    """Unmodelled ``delay`` [s] and factor ``gain`` of an axis at which the hover oscillates."""

    delay: float
    gain: float


class _Axis(NamedTuple):
    """Integrators with ``gains``, the first one outermost, behind an actuator with ``lags`` [s].

    ``weights`` are those of the integrators' states, ``weight`` that of the input. The last
    ``unmeasured`` states follow from the commands.
    """

    gains: tuple[float, ...]
    lags: tuple[float, ...]
    weights: tuple[float, ...]
    weight: float
    unmeasured: int = 0


@functools.lru_cache(maxsize=64)
def stability_margins(
    config: MpcConfig, rate_weight_scale: float | None = None
) -> StabilityMargins:
    """Return the smallest margins of the horizontal, vertical and yaw motion in hover.

    ``rate_weight_scale`` is the factor on the weights of the rates, None the initial factor.
    """
    scale = config.rate_weight_scale if rate_weight_scale is None else rate_weight_scale
    # As a rule pitch and roll are the same.
    margins = [_margins(axis, config) for axis in dict.fromkeys(_axes(config, scale))]
    return StabilityMargins(*(min(values) for values in zip(*margins, strict=True)))


def _axes(config: MpcConfig, rate_weight_scale: float) -> list[_Axis]:
    """Return the motion along x, y and z, and the turn about z."""
    rate_lags = np.maximum(per_axis(config.rate_time_constant), _SHORTEST_LAG)
    torque_lags = per_axis(config.torque_time_constant)
    roll, pitch, yaw = (
        (rate, torque) if torque > 0.0 else (rate,)
        for rate, torque in zip(rate_lags, torque_lags, strict=True)
    )
    hover = config.vehicle().hover_throttle
    change = config.thrust(hover + _CHANGE) - config.thrust(hover - _CHANGE)
    slope = 0.5 * change / _CHANGE / config.mass
    throttle = (max(config.thrust_time_constant, _SHORTEST_LAG),)
    (px, py, pz, vx, vy, vz, *turns), (thrust, *rates) = config.Q, config.R
    rates = [max(rate_weight_scale * R, min(R, LEAST_RATE_WEIGHT)) for R in rates]
    return [
        _Axis((1.0, config.gravity, 1.0), pitch, (px, vx, turns[1]), rates[1]),
        _Axis((1.0, config.gravity, 1.0), roll, (py, vy, turns[0]), rates[0]),
        _Axis((1.0, slope), throttle, (pz, vz), thrust, unmeasured=1),
        _Axis((1.0,), yaw, (turns[2],), rates[2]),
    ]


def _dynamics(axis: _Axis) -> tuple[Array, Array]:
    """Return A (n, n) and B (n, 1) of dx/dt = A x + B u."""
    size = len(axis.gains) + len(axis.lags)
    A, B = np.diag([*axis.gains, *np.ones(len(axis.lags) - 1)], 1), np.zeros((size, 1))
    if len(axis.lags) == 1:
        A[-1, -1], B[-1] = -1.0 / axis.lags[0], 1.0 / axis.lags[0]
    else:
        tau, lag = axis.lags
        A[-1, -2:], B[-1] = (-1.0 / (tau * lag), -1.0 / lag), 1.0 / (tau * lag)
    return A, B


def _feedback(axis: _Axis, config: MpcConfig) -> Array:
    """Return the gain K (1, n) of the first input of the plan."""
    A, B = _dynamics(axis)
    size = len(A)
    joint = np.zeros((size + 1, size + 1))
    joint[:size, :size], joint[:size, size:] = A, B
    step = _propagator(joint, config.horizon_step)
    A, B = step[:size, :size], step[:size, size:]
    Q = np.diag([*axis.weights, *np.zeros(len(axis.lags))])
    P, K = config.terminal_weight * Q, np.zeros((1, size))
    for _ in range(config.horizon_steps):
        curvature = axis.weight + B.T @ P @ B
        K = B.T @ P @ A / np.maximum(curvature, np.finfo(float).tiny)
        P = Q + A.T @ P @ (A - B @ K)
    return K


def _propagator(A: Array, duration: float) -> Array:
    """Return e^(A t) by repeated squaring; scipy.linalg would take 8 MiB in the MPC's process."""
    norm = duration * float(np.abs(A).sum(axis=1).max())
    fractions = 2 ** (6 + math.ceil(math.log2(max(norm, 1.0))))
    X = A * (duration / fractions)
    one = np.eye(len(A))
    series = one + X @ (one + X / 2.0 @ (one + X / 3.0 @ (one + X / 4.0)))
    return np.linalg.matrix_power(series, fractions)


def _margins(axis: _Axis, config: MpcConfig) -> StabilityMargins:
    K, (A, B), delay = _feedback(axis, config), _dynamics(axis), config.input_delay
    s = 1j * _FREQUENCIES
    G = np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B)[:, :, 0]
    G *= np.exp(-0.5 * s / config.control_rate)[:, None]  # held for the control period
    M = np.diag(np.arange(len(A)) < len(A) - axis.unmeasured)
    S, D = G @ K[0], np.exp(-s * delay) * (G @ M @ (K @ _propagator(A, delay))[0])
    L = D / (1.0 + S - D)
    size, phase = np.abs(L), np.angle(-L) % (2.0 * np.pi)  # above the critical point
    crossings = np.flatnonzero((size[:-1] > 1.0) != (size[1:] > 1.0))
    delays = phase[crossings] / _FREQUENCIES[crossings]
    turns = np.flatnonzero((np.diff(np.sign(L.imag)) != 0.0) & (L.real[:-1] < 0.0))
    gains = 1.0 / size[turns]
    return StabilityMargins(
        delay=float(np.min(delays, initial=np.inf)),
        gain=float(np.min(gains[gains > 1.0], initial=np.inf)),
    )
