"""What the odometry says of the truth: noise, bias, losses, and when it is measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from quad_mpc_ros.lie import so3
from quad_mpc_ros.model.samples import OdometrySample
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.parameters import Stream

# In periods; below one half, so that odometries stay in order.
_LARGEST_JITTER = 0.45


class Sensors:
    """Adds white noise and biases to the odometry and loses some.

    Position errs in the world, velocity, body rate and attitude in the body; the attitude by a
    rotation R exp(bias + noise), so that the quaternion stays of unit length.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        self._noise = np.repeat(
            [
                config.position_noise,
                config.attitude_noise,
                config.velocity_noise,
                config.rate_noise,
            ],
            3,
        )
        self._bias = np.concatenate(
            (config.position_bias, config.attitude_bias, config.velocity_bias, np.zeros(3))
        )
        self._exact = not (self._noise.any() or self._bias.any())
        self._dropout = config.odom_dropout
        self._noise_random = config.random(Stream.NOISE)
        self._dropout_random = config.random(Stream.DROPOUT)
        self._first = True

    def measured(self, truth: OdometrySample) -> OdometrySample:
        """Return what is measured of a true odometry."""
        if self._exact:
            return truth
        error = self._bias + self._noise * self._noise_random.standard_normal(12)
        position, attitude, velocity, body_rate = error.reshape(4, 3)
        R_WB = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw) @ so3.exp(attitude)
        return dataclasses.replace(
            truth,
            p_WB=truth.p_WB + position,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
            v_WB_B=truth.v_WB_B + velocity,
            w_WB_B=truth.w_WB_B + body_rate,
        )

    def lost(self) -> bool:
        """Whether the next odometry is lost; never the first, which starts the reference."""
        first, self._first = self._first, False
        drawn = self._dropout > 0.0 and self._dropout_random.random() < self._dropout
        return bool(drawn and not first)


def odometry_stamps(config: SimulatorConfig) -> Iterator[int]:
    """Yield the times of the measurements from the start [ns], for the configured duration.

    Each is computed from its number, so that no rounding accumulates, and jittered on its own.
    The first is on time.
    """
    random = config.random(Stream.JITTER)
    jitter = config.odom_jitter * config.odom_rate
    count = round(config.duration * config.odom_rate) if config.duration > 0.0 else None
    number = 0
    while count is None or number < count:
        early = 0.0
        if jitter > 0.0 and number > 0:
            drawn = jitter * random.standard_normal()
            early = min(max(drawn, -_LARGEST_JITTER), _LARGEST_JITTER)
        yield round((number + early) * 1e9 / config.odom_rate)
        number += 1
