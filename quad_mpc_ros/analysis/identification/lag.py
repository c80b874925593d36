# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Response of the controller's rate-loop model to commands held constant.

Exact at any time (:mod:`quad_mpc_ros.control.model.actuators`). Without a torque lag the response
is a first-order lag.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.actuators import axis_step, first_order_lag, loop_step

_SHORTEST = 1e-12  # s


class LaggedCommands:
    """The response y to commands c, each held until the next.

    The response has no delay, which only shifts the time.
    """

    def __init__(
        self,
        time: Array,
        command: Array,
        *,
        time_constant: ArrayLike,
        torque_time_constant: ArrayLike = 0.0,
    ) -> None:
        """Take the commands (m, k) from ``time`` (m,) [s] on, ascending.

        y starts at rest, equal to the first command. The time constants tau and T [s] are one
        number or k numbers.
        """
        self._time, self._command = time, np.ascontiguousarray(command)
        self._lags = np.empty((2, command.shape[1]))
        self._lags[0], self._lags[1] = time_constant, torque_time_constant
        self._starts = _starts(self._command, np.diff(time), self._lags)

    def at(self, time: Array) -> Array:
        """Return the response (n, k) at times (n,)."""
        return self._responses(time, self._index(time), np.zeros_like(time))[..., 0]

    def means(self, time: Array, duration: Array) -> tuple[Array, Array]:
        """Return the means (n, k) of y and of y^2 over intervals without a new command.

        The mean of y^2 is exact for a lag of first order.
        """
        # Use a time inside the stretch, so that rounding at its edge selects no other command.
        index = self._index(time + 0.5 * duration)
        responses = self._responses(time, index, duration)
        return responses[..., 1], responses[..., 2]

    def _responses(self, time: Array, index: np.ndarray, duration: Array) -> Array:
        since = np.maximum(time - self._time[index], 0.0)
        return _responses(
            self._command[index], self._starts[index], since, duration, lags=self._lags
        )

    def _index(self, time: Array) -> np.ndarray:
        return np.maximum(np.searchsorted(self._time, time, side="right") - 1, 0)


@compiled
def _starts(command: Array, duration: Array, lags: Array) -> Array:
    """Return y and its slope (m, k, 2) at the start of each command."""
    starts = np.zeros((*command.shape, 2))
    for k in range(command.shape[1]):
        y, slope = command[0, k], 0.0
        starts[0, k, 0] = y
        for j in range(len(duration)):
            loop = loop_step(lags[0, k], lags[1, k], math.inf, duration[j])
            step = axis_step(loop, y, slope, command[j, k])
            y, slope = step.rate, step.acceleration
            starts[j + 1, k, 0], starts[j + 1, k, 1] = y, slope
    return starts


@compiled
def _responses(command: Array, starts: Array, since: Array, duration: Array, lags: Array) -> Array:
    """Return y ``since`` commands, and the means of y and y^2 over durations (n, k, 3)."""
    responses = np.empty((*command.shape, 3))
    for i in range(len(since)):
        for k in range(command.shape[1]):
            held, tau, torque = command[i, k], lags[0, k], lags[1, k]
            loop = loop_step(tau, torque, math.inf, max(since[i], _SHORTEST))
            begin = axis_step(loop, starts[i, k, 0], starts[i, k, 1], held)
            seconds = max(duration[i], _SHORTEST)
            loop = loop_step(tau, torque, math.inf, seconds)
            mean = axis_step(loop, begin.rate, begin.acceleration, held).mean
            _, share = first_order_lag(0.5 * tau, seconds)
            square = held * (2.0 * mean - held) + share * (begin.rate - held) ** 2
            responses[i, k, 0], responses[i, k, 1] = begin.rate, mean
            responses[i, k, 2] = square
    return responses
