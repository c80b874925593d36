"""The parameters of the plant ``betaflight``, beside those of the plant ``rotors``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters


@dataclass(frozen=True, kw_only=True)
class FirmwareParameters(Configuration):
    """How the firmware is set up."""

    owner = "simulator.betaflight"

    rate_max: float = parameter(
        12.2,
        doc="Body rate at full stick, the same for each axis; linear below it.",
        unit="rad/s",
        minimum=0.2,
        maximum=34.0,
    )
    settings: tuple[str, ...] = parameter(
        ("feature AIRMODE",), doc="Lines for the firmware's command line, before it flies."
    )


@dataclass(frozen=True, kw_only=True)
class BetaflightParameters(RotorsPlantParameters):
    """Its own, in a group."""

    betaflight: FirmwareParameters = dataclasses.field(default_factory=FirmwareParameters)
