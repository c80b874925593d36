"""Commands that are held, and what follows them with a first-order lag: exact, at any time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array

# A shorter time constant is none at the rates at which anything is sampled.
_MIN_TIME_CONSTANT = 1e-5


class LaggedCommands:
    """The response y of dy/dt = (c - y) / tau to commands c, each held until the next.

    Without delay: a delay only shifts the time that is asked for.
    """

    def __init__(self, time: Array, command: Array, *, time_constant: ArrayLike) -> None:
        """Take the commands (m, k) from ``time`` (m,) [s] on, ascending; y begins at rest there.

        At rest is: equal to the first command. Time constants [s] are one, or k.
        """
        self._tau = np.maximum(np.asarray(time_constant, dtype=np.float64), _MIN_TIME_CONSTANT)
        self._time, self._command = time, command
        decays = np.exp(-np.diff(time)[:, None] / self._tau) * np.ones_like(command[1:])
        self._start = _followed(np.ascontiguousarray(command), decays)

    def at(self, time: Array) -> Array:
        """Return the response (n, k) at times (n,)."""
        command, excess = self._parts(time, self._index(time))
        return np.asarray(command + excess)

    def means(self, time: Array, duration: Array) -> tuple[Array, Array]:
        """Return the means (n, k) of y and of y^2 over stretches that no command divides."""
        # By a time inside the stretch, so that rounding at its edge picks no other command.
        command, excess = self._parts(time, self._index(time + 0.5 * duration))
        share = self._mean_decay(duration)
        share_squared = self._mean_decay(2.0 * duration)
        mean = command + excess * share
        mean_square = command**2 + 2.0 * command * excess * share + excess**2 * share_squared
        return mean, mean_square

    def _parts(self, time: Array, index: np.ndarray) -> tuple[Array, Array]:
        command = self._command[index]
        since = np.maximum(time - self._time[index], 0.0)
        return command, (self._start[index] - command) * np.exp(-since[:, None] / self._tau)

    def _index(self, time: Array) -> np.ndarray:
        return np.maximum(np.searchsorted(self._time, time, side="right") - 1, 0)

    def _mean_decay(self, duration: Array) -> Array:
        """Return the means (n, k) or (n, 1) of exp(-t / tau) over durations (n,)."""
        x = duration[:, None] / self._tau
        return np.asarray(-np.expm1(-x) / np.maximum(x, 1e-12)) + (x < 1e-12)


@compiled
def _followed(command: Array, decays: Array) -> Array:
    """Return where the response (m, k) is as each command begins, with what is kept between."""
    start = np.empty_like(command)
    start[0] = command[0]
    for j in range(len(decays)):
        for k in range(command.shape[1]):
            start[j + 1, k] = command[j, k] + decays[j, k] * (start[j, k] - command[j, k])
    return start
