# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of every plant, and the random numbers of a simulation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.vehicle import Vehicle, VehicleParameters

LONGEST_TIME_CONSTANT = 10.0  # s
_QUATERNION_TOLERANCE = 1e-3  # of its length
_NOISE_BLOCK_SIZE = 64  # rows


class Stream(IntEnum):
    """Purposes of random numbers. Never renumber them: seeds would change meaning."""

    GUSTS = 0
    NOISE = 1
    DROPOUT = 2
    JITTER = 3
    DRIFT = 4
    IMU = 5


@dataclass(frozen=True, kw_only=True)
class PlantParameters(VehicleParameters):
    """The parameters of every plant: true vehicle, initial state, commands and air.

    A plant declares its own parameters in a class derived from this one. The simulator node has
    the parameters of all plants, so names must be distinct.
    """

    owner = "simulator"

    integration_step: float = parameter(
        0.005,
        doc="Longest step of the integrator.",
        unit="s",
        minimum=1e-5,
        maximum=0.05,
        advanced=True,
    )
    mass_scale: float = parameter(1.0, doc="Ratio of the true to the configured mass.", above=0.0)
    thrust_scale: float = parameter(1.0, doc="Ratio of true to configured thrust.", above=0.0)
    command_delay: float = parameter(
        0.02, doc="Delay from the arrival of a command to its effect.", unit="s", minimum=0.0
    )
    wind: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Steady wind in the world; drag acts against it.",
        unit="m/s",
        length=3,
    )
    gust_intensity: float = parameter(
        0.0, doc="Standard deviation of the gusts along each axis.", unit="m/s", minimum=0.0
    )
    gust_length: float = parameter(
        20.0, doc="Scale length of the gusts, 15 m to 25 m near the ground.", unit="m", above=0.0
    )
    seed: int = parameter(0, doc="Seed of gusts, noise, jitter and dropouts.", minimum=0)
    initial_position: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Initial position.", unit="m", length=3
    )
    initial_velocity: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Initial velocity, in the world.", unit="m/s", length=3
    )
    initial_attitude: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0, 1.0),
        doc="Initial attitude, quaternion x, y, z, w of body to world; level, heading east.",
        length=4,
    )
    initial_body_rates: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Initial body rates, held until the first command acts.",
        unit="rad/s",
        length=3,
    )
    initial_throttle: float = parameter(
        0.0,
        doc="Initial throttle, held until the first command acts.",
        minimum=0.0,
        maximum=1.0,
    )
    frame_id: str = parameter("odom", doc="World frame of the odometry.")
    child_frame_id: str = parameter("base_link", doc="Body frame of the odometry.")

    def check(self) -> None:
        """Reject a start below the ground and an attitude without unit length."""
        super().check()
        self.check_hover("mass_scale", self.mass_scale, self.mass * self.mass_scale)
        if self.initial_position[2] < 0.0:
            raise ConfigurationError(
                f"{self.owner}.initial_position",
                self.initial_position,
                "3 numbers, the height (third) >= 0",
            )
        if abs(math.hypot(*self.initial_attitude) - 1.0) > _QUATERNION_TOLERANCE:
            raise ConfigurationError(
                f"{self.owner}.initial_attitude",
                self.initial_attitude,
                "a quaternion x, y, z, w of length 1",
            )

    def vehicle(self) -> Vehicle:
        """Return the true vehicle."""
        nominal = super().vehicle()
        a, b, c = (self.thrust_scale * coefficient for coefficient in self.thrust_curve)
        return dataclasses.replace(
            nominal, mass=self.mass * self.mass_scale, thrust_curve=(a, b, c)
        )

    def random(self, stream: Stream) -> np.random.Generator:
        """Return a new generator of the random numbers for one purpose.

        The streams are independent: enabling an effect does not change the random numbers of other
        effects.
        """
        return np.random.default_rng([self.seed, stream])


def white_noise(random: np.random.Generator, size: int) -> Iterator[Array]:
    """Yield rows (size,) from N(0, 1) without end, drawn in blocks."""
    while True:
        yield from random.standard_normal((_NOISE_BLOCK_SIZE, size))
