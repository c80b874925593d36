"""The parameters of the plant ``mujoco``, in addition to those of the plant ``rotors``.

Lengths in the world are in its frame, in which the origin of a vehicle that stands on level ground
is at height 0: the ground is ``airframe.clearance`` below.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, ConfigurationError, parameter
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters

_MAX_SLOPE = math.radians(60.0)


@dataclass(frozen=True, kw_only=True)
class ContactParameters(Configuration):
    """Contact between two bodies."""

    owner = "simulator.mujoco.contact"

    friction: float = parameter(
        0.8, doc="Coefficient of sliding friction.", minimum=1e-3, maximum=10.0
    )
    time_constant: float = parameter(
        0.01,
        doc="Time in which what touches is pushed apart; softer is longer.",
        unit="s",
        minimum=0.002,
        maximum=0.2,
    )
    damping_ratio: float = parameter(
        1.0, doc="Damping of that: at 1 nothing bounces, below it does.", above=0.0, maximum=10.0
    )


@dataclass(frozen=True, kw_only=True)
class GroundParameters(Configuration):
    """The ground, a plane without end."""

    owner = "simulator.mujoco.ground"

    slope: float = parameter(
        0.0, doc="Inclination of the ground.", unit="rad", minimum=0.0, maximum=_MAX_SLOPE
    )
    slope_heading: float = parameter(
        0.0, doc="Way up the slope, from east anticlockwise.", unit="rad"
    )


@dataclass(frozen=True, kw_only=True)
class GearParameters(Configuration):
    """Four feet below the body, ``airframe.clearance`` below its origin."""

    owner = "simulator.mujoco.gear"

    length: float = parameter(
        0.0,
        doc="Distance from the front feet to the rear ones; 0 is as far apart as the rotors.",
        unit="m",
        minimum=0.0,
    )
    width: float = parameter(
        0.0,
        doc="Distance from the left feet to the right ones; 0 is as far apart as the rotors.",
        unit="m",
        minimum=0.0,
    )
    foot_radius: float = parameter(0.005, doc="Radius of a foot, a ball.", unit="m", above=0.0)


@dataclass(frozen=True, kw_only=True)
class DeckParameters(Configuration):
    """A deck that heaves and rocks; its motion does not yield to what stands on it.

    Height, roll and pitch are sines of time, each of its own amplitude.
    """

    owner = "simulator.mujoco.deck"

    size: tuple[float, ...] = parameter(
        (0.0, 0.0), doc="Lengths along x and y; 0, 0 is no deck.", unit="m", length=2, minimum=0.0
    )
    position: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.5), doc="Middle of its upper face at rest.", unit="m", length=3
    )
    heave_amplitude: float = parameter(0.0, doc="How far it heaves.", unit="m", minimum=0.0)
    heave_frequency: float = parameter(0.2, doc="How often it heaves.", unit="Hz", above=0.0)
    roll_amplitude: float = parameter(
        0.0, doc="How far it rocks about x.", unit="rad", minimum=0.0, maximum=0.7
    )
    pitch_amplitude: float = parameter(
        0.0, doc="How far it rocks about y.", unit="rad", minimum=0.0, maximum=0.7
    )
    rock_frequency: float = parameter(0.2, doc="How often it rocks.", unit="Hz", above=0.0)
    heave_phase: float = parameter(0.0, doc="Angle of the heave's sine at the start.", unit="rad")
    roll_phase: float = parameter(0.0, doc="Angle of the roll's sine at the start.", unit="rad")
    pitch_phase: float = parameter(0.0, doc="Angle of the pitch's sine at the start.", unit="rad")

    @property
    def exists(self) -> bool:
        """Whether there is one."""
        return min(self.size) > 0.0

    def check(self) -> None:
        """Refuse a deck of a length and no width."""
        if not self.exists and max(self.size) > 0.0:
            raise ConfigurationError(
                f"{self.owner}.size", self.size, "2 numbers > 0, or 0, 0 for no deck"
            )


@dataclass(frozen=True, kw_only=True)
class WallParameters(Configuration):
    """Upright walls, one for each element of the lists."""

    owner = "simulator.mujoco.walls"

    x: tuple[float, ...] = parameter((), doc="Their middles, east.", unit="m")
    y: tuple[float, ...] = parameter((), doc="Their middles, north.", unit="m")
    heading: tuple[float, ...] = parameter(
        (), doc="The ways along which they stand, from east anticlockwise.", unit="rad"
    )
    length: tuple[float, ...] = parameter((), doc="Their lengths.", unit="m", above=0.0)
    height: float = parameter(3.0, doc="Height of all, from height 0 on.", unit="m", above=0.0)
    thickness: float = parameter(0.1, doc="Thickness of all.", unit="m", above=0.0)

    def check(self) -> None:
        """Refuse lists of different lengths."""
        for name in ("y", "heading", "length"):
            if len(getattr(self, name)) != len(self.x):
                raise ConfigurationError(
                    f"{self.owner}.{name}", getattr(self, name), f"{len(self.x)} numbers, as x has"
                )


@dataclass(frozen=True, kw_only=True)
class PayloadParameters(Configuration):
    """A ball on a cable that has neither mass nor stretch and can go slack; no air acts on it."""

    owner = "simulator.mujoco.payload"

    mass: float = parameter(0.0, doc="Mass of the load; 0 is none.", unit="kg", minimum=0.0)
    cable_length: float = parameter(
        0.5, doc="From the attachment to the middle of the load.", unit="m", above=0.0
    )
    attachment: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Where the cable is fixed in the body.", unit="m", length=3
    )
    radius: float = parameter(0.01, doc="Radius of the load.", unit="m", above=0.0)


@dataclass(frozen=True, kw_only=True)
class SurroundingsParameters(Configuration):
    """Contact, ground, gear, deck, walls and payload."""

    owner = "simulator.mujoco"

    contact: ContactParameters = dataclasses.field(default_factory=ContactParameters)
    ground: GroundParameters = dataclasses.field(default_factory=GroundParameters)
    gear: GearParameters = dataclasses.field(default_factory=GearParameters)
    deck: DeckParameters = dataclasses.field(default_factory=DeckParameters)
    walls: WallParameters = dataclasses.field(default_factory=WallParameters)
    payload: PayloadParameters = dataclasses.field(default_factory=PayloadParameters)


@dataclass(frozen=True, kw_only=True)
class MujocoParameters(RotorsPlantParameters):
    """Its own, in groups within a group."""

    mujoco: SurroundingsParameters = dataclasses.field(default_factory=SurroundingsParameters)
