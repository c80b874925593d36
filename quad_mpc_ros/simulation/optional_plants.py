"""The parameters of the plants ``betaflight`` and ``rotorpy``, which are optional parts."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.simulation.parameters import PlantParameters
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters


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
