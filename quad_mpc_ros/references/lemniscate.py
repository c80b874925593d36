"""A lying eight, x = A_x sin(w t) and y = A_y sin(2 w t), flown with the nose to the east.

Smooth and, by differential flatness with drag, complete: attitude, body rates and acceleration
belong to the path. It crosses its origin at t = 0, in full motion.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.flatness import flat_inputs, flat_samples
from quad_mpc_ros.references.trajectory import TrajectorySamples, held

_CHECKED_TIMES = 1000


class Lemniscate:
    """The eight, round and round."""

    smooth = True

    def __init__(self, config: ReferenceConfig) -> None:
        self._config = config
        self._origin = np.array([*config.origin, config.height])
        self._amplitude = np.array([config.amplitude_x, config.amplitude_y, 0.0])
        self._frequency = config.angular_frequency * np.array([1.0, 2.0, 0.0])
        self._refuse_what_cannot_be_flown()

    @property
    def period_ns(self) -> int:
        """Once round the eight."""
        return round(1e9 * math.tau / self._config.angular_frequency)

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the samples at these times; before the start its position, at rest."""
        seconds = 1e-9 * np.array(times_ns, dtype=np.float64)
        p, v, a, j = self._path(np.maximum(seconds, 0.0))
        gravity, drag = self._config.gravity, self._config.drag
        moving = flat_samples(p_WB=p, v_WB_W=v, a_WB_W=a, j_WB_W=j, gravity=gravity, drag=drag)
        return held(moving, seconds < 0.0)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the start, which is from rest into motion, if it is in (start, end]."""
        return [0] if start_ns < 0 <= end_ns else []

    def before(self, time_ns: int) -> TrajectorySamples:
        """Return the sample just before a time."""
        return self.at([time_ns - 1])

    def _path(self, seconds: Array) -> tuple[Array, Array, Array, Array]:
        """Return position, velocity, acceleration and jerk, (n, 3) each."""
        w = self._frequency
        phase = seconds[:, None] * w
        sine, cosine = self._amplitude * np.sin(phase), self._amplitude * np.cos(phase)
        return self._origin + sine, w * cosine, -(w**2) * sine, -(w**3) * cosine

    def _refuse_what_cannot_be_flown(self) -> None:
        """Raise :class:`ConfigurationError` when a thrust along the path is out of reach."""
        seconds = np.linspace(0.0, math.tau / self._config.angular_frequency, _CHECKED_TIMES)
        vehicle = self._config.vehicle()
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                _, v, a, j = self._path(seconds)
                thrust = (
                    vehicle.mass
                    * flat_inputs(
                        v_WB_W=v, a_WB_W=a, j_WB_W=j, gravity=vehicle.gravity, drag=vehicle.drag
                    ).specific_thrust
                )
            vehicle.throttle_for(float(np.min(thrust)))
            vehicle.throttle_for(float(np.max(thrust)))
        except ValueError as error:
            raise ConfigurationError(
                f"{self._config.owner}.angular_frequency",
                self._config.angular_frequency,
                f"a number with which the vehicle can fly the lemniscate: {error}",
            ) from error
