# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the plants ``betaflight``, ``mujoco`` and ``rotorpy``, optional parts.

``betaflight`` and ``mujoco`` also have the parameters of the plant ``rotors``. The origin of a
vehicle at rest on level ground is at height 0 of the world: the ground of ``mujoco`` is
``airframe.clearance`` below.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, ConfigurationError, parameter
from quad_mpc_ros.simulation.parameters import PlantParameters
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters

_MAX_SLOPE = math.radians(60.0)


@dataclass(frozen=True, kw_only=True)
class FirmwareParameters(Configuration):
    """Settings of the firmware."""

    owner = "simulator.betaflight"

    rate_max: float = parameter(
        12.2,
        doc="Body rate at full stick of all axes; the rate curve is linear.",
        unit="rad/s",
        minimum=0.2,
        maximum=34.0,
    )
    settings: tuple[str, ...] = parameter(
        ("feature AIRMODE",), doc="Lines for the firmware's command line, before the flight."
    )


@dataclass(frozen=True, kw_only=True)
class BetaflightParameters(RotorsPlantParameters):
    """The own parameters of the plant ``betaflight``, in a group."""

    betaflight: FirmwareParameters = dataclasses.field(default_factory=FirmwareParameters)


@dataclass(frozen=True, kw_only=True)
class RotorpyParameters(PlantParameters):
    """The own parameters of the plant ``rotorpy``."""

    rotorpy_rate_gain: float = parameter(
        20.0,
        doc="Gain k_w of rotorpy's rate loop, about the reciprocal of its time constant.",
        unit="1/s",
        above=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class ContactParameters(Configuration):
    """Contact between two bodies."""

    owner = "simulator.mujoco.contact"

    friction: float = parameter(
        0.8, doc="Coefficient of sliding friction.", minimum=1e-3, maximum=10.0
    )
    time_constant: float = parameter(
        0.01,
        doc="Time constant of the contact force; longer is softer.",
        unit="s",
        minimum=0.002,
        maximum=0.2,
    )
    damping_ratio: float = parameter(
        1.0, doc="Damping ratio; contacts bounce below 1.", above=0.0, maximum=10.0
    )


@dataclass(frozen=True, kw_only=True)
class GroundParameters(Configuration):
    """The ground, an unlimited plane."""

    owner = "simulator.mujoco.ground"

    slope: float = parameter(
        0.0, doc="Inclination of the ground.", unit="rad", minimum=0.0, maximum=_MAX_SLOPE
    )
    slope_heading: float = parameter(
        0.0, doc="Uphill direction, anticlockwise from east.", unit="rad"
    )


@dataclass(frozen=True, kw_only=True)
class GearParameters(Configuration):
    """Four feet below the body, ``airframe.clearance`` below its origin."""

    owner = "simulator.mujoco.gear"

    length: float = parameter(
        0.0,
        doc="Distance between front and rear feet; 0 uses the distance of the rotors.",
        unit="m",
        minimum=0.0,
    )
    width: float = parameter(
        0.0,
        doc="Distance between left and right feet; 0 uses the distance of the rotors.",
        unit="m",
        minimum=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class DeckParameters(Configuration):
    """A deck that heaves and rocks; contact forces do not move it.

    Height, roll and pitch are sines of time.
    """

    owner = "simulator.mujoco.deck"

    size: tuple[float, ...] = parameter(
        (0.0, 0.0),
        doc="Lengths of the deck along x and y; 0, 0 disables the deck.",
        unit="m",
        length=2,
        minimum=0.0,
    )
    position: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.5), doc="Centre of the upper face at rest.", unit="m", length=3
    )
    heave_amplitude: float = parameter(0.0, doc="Amplitude of the heave.", unit="m", minimum=0.0)
    heave_frequency: float = parameter(0.2, doc="Frequency of the heave.", unit="Hz", above=0.0)
    roll_amplitude: float = parameter(
        0.0, doc="Amplitude of the roll.", unit="rad", minimum=0.0, maximum=0.7
    )
    pitch_amplitude: float = parameter(
        0.0, doc="Amplitude of the pitch.", unit="rad", minimum=0.0, maximum=0.7
    )
    rock_frequency: float = parameter(
        0.2, doc="Frequency of roll and pitch.", unit="Hz", above=0.0
    )
    heave_phase: float = parameter(0.0, doc="Phase of the heave at the start.", unit="rad")
    roll_phase: float = parameter(0.0, doc="Phase of the roll at the start.", unit="rad")
    pitch_phase: float = parameter(0.0, doc="Phase of the pitch at the start.", unit="rad")

    @property
    def exists(self) -> bool:
        """Whether there is a deck."""
        return min(self.size) > 0.0

    def check(self) -> None:
        """Reject a deck with a length and no width."""
        if not self.exists and max(self.size) > 0.0:
            raise ConfigurationError(
                f"{self.owner}.size", self.size, "2 numbers > 0, or 0, 0 for no deck"
            )


@dataclass(frozen=True, kw_only=True)
class PayloadParameters(Configuration):
    """A ball without drag on a massless, inextensible cable, which can go slack."""

    owner = "simulator.mujoco.payload"

    mass: float = parameter(0.0, doc="Mass of the load; 0 disables it.", unit="kg", minimum=0.0)
    cable_length: float = parameter(
        0.5, doc="Distance from the attachment to the centre of the load.", unit="m", above=0.0
    )
    attachment: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Attachment of the cable in the body.", unit="m", length=3
    )


@dataclass(frozen=True, kw_only=True)
class SurroundingsParameters(Configuration):
    """Contact, ground, gear, deck and payload."""

    owner = "simulator.mujoco"

    contact: ContactParameters = dataclasses.field(default_factory=ContactParameters)
    ground: GroundParameters = dataclasses.field(default_factory=GroundParameters)
    gear: GearParameters = dataclasses.field(default_factory=GearParameters)
    deck: DeckParameters = dataclasses.field(default_factory=DeckParameters)
    payload: PayloadParameters = dataclasses.field(default_factory=PayloadParameters)


@dataclass(frozen=True, kw_only=True)
class MujocoParameters(RotorsPlantParameters):
    """The own parameters of the plant ``mujoco``, in groups."""

    mujoco: SurroundingsParameters = dataclasses.field(default_factory=SurroundingsParameters)
