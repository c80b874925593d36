"""Commands that are held, and what follows them through a loop of second order: exact, any time.

The loop is that of the controller's model (``control/model/rate_loop.py``), without its bound,

    dy/dt = a,    T da/dt = (c - y) / tau - a,

a lag of first order where T is 0. Its modes are exponentials, complex ones where it overshoots.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array

# A shorter time constant is none at the rates at which anything is sampled.
_MIN_TIME_CONSTANT = 1e-5
_NO_TORQUE_LAG = 1e-12
_MIN_SPLIT = 1e-4  # between two modes, as a share of their mean
_Modes = NDArray[np.complex128]


class _Steps(NamedTuple):
    """From y - c and a at the start of commands (m, k) to those at their ends."""

    distance: Array
    distance_by_slope: Array
    slope_by_distance: Array
    slope: Array


class LaggedCommands:
    """The response y to commands c, each held until the next.

    Without delay: a delay only shifts the time that is asked for.
    """

    def __init__(
        self,
        time: Array,
        command: Array,
        *,
        time_constant: ArrayLike,
        torque_time_constant: ArrayLike = 0.0,
    ) -> None:
        """Take the commands (m, k) from ``time`` (m,) [s] on, ascending; y begins at rest there.

        At rest is: equal to the first command. Time constants, tau and T [s], are one, or k.
        """
        tau = np.maximum(np.asarray(time_constant, dtype=np.float64), _MIN_TIME_CONSTANT)
        lag = np.maximum(np.asarray(torque_time_constant, dtype=np.float64), _NO_TORQUE_LAG)
        middle, product = -0.5 / lag, 1.0 / (tau * lag)
        split: _Modes = np.sqrt((middle * middle - product).astype(np.complex128))
        split = np.where(np.abs(split) < -_MIN_SPLIT * middle, -_MIN_SPLIT * middle, split)
        fast: _Modes = middle - split
        self._modes = product / fast, fast
        self._time, self._command = time, np.ascontiguousarray(command)
        self._distance, self._slope = _followed(self._command, self._steps(np.diff(time)))

    def at(self, time: Array) -> Array:
        """Return the response (n, k) at times (n,)."""
        command, *amplitudes = self._parts(time, self._index(time))
        return np.asarray(command + sum(amplitude.real for amplitude in amplitudes))

    def means(self, time: Array, duration: Array) -> tuple[Array, Array]:
        """Return the means (n, k) of y and of y^2 over stretches that no command divides."""
        # By a time inside the stretch, so that rounding at its edge picks no other command.
        command, *amplitudes = self._parts(time, self._index(time + 0.5 * duration))
        (first, second), (a, b) = amplitudes, self._modes
        mean = (first * _mean(a, duration) + second * _mean(b, duration)).real
        square = first * first * _mean(2.0 * a, duration)
        square += 2.0 * first * second * _mean(a + b, duration)
        square += second * second * _mean(2.0 * b, duration)
        return command + mean, command**2 + 2.0 * command * mean + square.real

    def _steps(self, duration: Array) -> _Steps:
        a, b = self._modes
        first, second = (np.exp(mode * duration[:, None]) for mode in self._modes)
        return _Steps(
            *(
                np.ascontiguousarray((part / (a - b) * np.ones(self._command.shape[1])).real)
                for part in (
                    a * second - b * first,
                    first - second,
                    a * b * (second - first),
                    a * first - b * second,
                )
            )
        )

    def _parts(self, time: Array, index: np.ndarray) -> tuple[Array, _Modes, _Modes]:
        """Return the commands in force at times (n,), and the modes' shares of y - c (n, k)."""
        a, b = self._modes
        since = np.maximum(time - self._time[index], 0.0)[:, None]
        distance, slope = self._distance[index], self._slope[index]
        first = (slope - b * distance) / (a - b)
        return (
            self._command[index],
            first * np.exp(a * since),
            (distance - first) * np.exp(b * since),
        )

    def _index(self, time: Array) -> np.ndarray:
        return np.maximum(np.searchsorted(self._time, time, side="right") - 1, 0)


def _mean(mode: _Modes, duration: Array) -> _Modes:
    """Return the means (n, k) or (n, 1) of a mode's exponential over durations (n,)."""
    x = mode * np.maximum(duration, 1e-12)[:, None]
    return np.asarray(np.expm1(x) / x)


@compiled
def _followed(command: Array, steps: _Steps) -> tuple[Array, Array]:
    """Return y - c and its slope (m, k) as each command begins."""
    distance, slope = np.zeros_like(command), np.zeros_like(command)
    for j in range(len(command) - 1):
        for k in range(command.shape[1]):
            before, rising = distance[j, k], slope[j, k]
            distance[j + 1, k] = steps.distance[j, k] * before + command[j, k] - command[j + 1, k]
            distance[j + 1, k] += steps.distance_by_slope[j, k] * rising
            slope[j + 1, k] = steps.slope_by_distance[j, k] * before + steps.slope[j, k] * rising
    return distance, slope
