# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The registered plants, and the parameters of the simulator node.

To add a plant, add its name to ``PLANTS`` and its own parameters, if any, as a base of
:class:`OwnParameters`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from quad_mpc_ros.configuration import (
    Configuration,
    ConfigurationError,
    ExtensibleConfiguration,
    optional_part,
    parameter,
    registered,
)
from quad_mpc_ros.control.model.vehicle import VehicleParameters
from quad_mpc_ros.simulation.internal_plant import InternalParameters, InternalPlant
from quad_mpc_ros.simulation.optional_plants import (
    BetaflightParameters,
    MujocoParameters,
    RotorpyParameters,
)
from quad_mpc_ros.simulation.plant import Plant
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant
from quad_mpc_ros.simulation.surroundings import ObstacleSensorParameters

P_contra = TypeVar("P_contra", contravariant=True)


@dataclass(frozen=True, kw_only=True)
class PlantEntry(Generic[P_contra]):
    """Registration of a plant.

    Other packages register a plant with an entry point of the group ``quad_mpc_ros.plants``;
    ``parameters`` is the class of the plant's parameters. ``preset`` is the parameter file with
    the vehicle of the plant, for the controller. ``has_own`` names parameters that this plant
    replaces; they must keep their defaults.
    """

    make: Callable[[P_contra], Plant]
    parameters: type[Configuration] | None = None
    preset: str = ""
    has_own: tuple[str, ...] = ()


def _optional(name: str) -> Callable[[SimulatorConfig], Plant]:
    """Return the factory of a plant that is an optional part of the package."""

    def make(config: SimulatorConfig) -> Plant:
        plant: Plant = optional_part(f"{name}_plant", needed_by="simulator.plant")(config)
        return plant

    return make


_OWN_LAGS = ("dynamics", "rate_time_constant", "rate_gain", "thrust_time_constant")

PLANTS: dict[str, PlantEntry[SimulatorConfig]] = {
    "betaflight": PlantEntry(make=_optional("betaflight"), preset="betaflight", has_own=_OWN_LAGS),
    "internal": PlantEntry(make=InternalPlant),
    "mujoco": PlantEntry(make=_optional("mujoco"), preset="vehicles/paper", has_own=_OWN_LAGS),
    "rotorpy": PlantEntry(make=_optional("rotorpy"), preset="rotorpy", has_own=_OWN_LAGS),
    "rotors": PlantEntry(make=RotorsPlant, preset="vehicles/paper", has_own=_OWN_LAGS),
}


def plant_entry(name: str) -> PlantEntry[SimulatorConfig] | None:
    """Return the entry of a plant of this or another package, None for an unknown name."""
    found = PLANTS.get(name) or registered(SimulatorConfig.group, name)
    assert found is None or isinstance(found, PlantEntry)
    return found


def make_plant(config: SimulatorConfig) -> Plant:
    """Return the configured plant in its initial state.

    Raises :class:`UserError` if a requirement is not installed.
    """
    return config.entry().make(config)


def compile_plant(config: SimulatorConfig) -> None:
    """Compile the code of the configured plant; raises like :func:`make_plant`."""
    plant = make_plant(config)
    plant.advance_to(1)
    plant.odometry(1)


@dataclass(frozen=True, kw_only=True)
class PlantChoiceParameters(ExtensibleConfiguration, VehicleParameters):
    """Selection of the plant."""

    owner = "simulator"
    choice = "plant"
    group = "quad_mpc_ros.plants"

    plant: str = parameter(
        "internal",
        doc="The simulated vehicle: the MPC's model (internal); rotors, body, battery and rate "
        "loop (rotors), with the firmware Betaflight (optional) or with contacts, deck and load "
        "in MuJoCo (optional); or the Hummingbird of rotorpy (optional).",
        choices=tuple(PLANTS),
    )


# The parameters are listed in the order of the bases, the last one first.
@dataclass(frozen=True, kw_only=True)
class OwnParameters(BetaflightParameters, MujocoParameters, RotorpyParameters, InternalParameters):
    """The own parameters of all plants."""


@dataclass(frozen=True, kw_only=True)
class SimulatorConfig(OwnParameters, PlantChoiceParameters):
    """The plant, with separate parameters so that it can differ from the controller's model.

    By default there is no wind, noise or loss.
    """

    pins = "plant"  # a file that chooses a plant also describes its vehicle

    odom_rate: float = parameter(50.0, doc="Odometry messages per second.", unit="Hz", above=0.0)
    position_noise: float = parameter(
        0.0, doc="Standard deviation of the measured position.", unit="m", minimum=0.0
    )
    attitude_noise: float = parameter(
        0.0,
        doc="Standard deviation of the measured attitude about each body axis.",
        unit="rad",
        minimum=0.0,
    )
    velocity_noise: float = parameter(
        0.0, doc="Standard deviation of the measured velocity.", unit="m/s", minimum=0.0
    )
    rate_noise: float = parameter(
        0.0, doc="Standard deviation of the measured body rates.", unit="rad/s", minimum=0.0
    )
    velocity_drift: float = parameter(
        0.0,
        doc="Standard deviation along each world axis of a correlated error of the measured "
        "velocity, like those of autopilot estimators: a Gauss-Markov process over 1 s.",
        unit="m/s",
        minimum=0.0,
    )
    position_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Constant error of the measured position, in the world.",
        unit="m",
        length=3,
    )
    velocity_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Constant error of the measured velocity, in the body.",
        unit="m/s",
        length=3,
    )
    attitude_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Constant error of the measured attitude, a rotation vector in the body.",
        unit="rad",
        length=3,
    )
    imu_rate: float = parameter(
        0.0,
        doc="Rate of the accelerometer on the topic imu; 0 disables it. Each odometry comes "
        "with a whole number of equally spaced samples.",
        unit="Hz",
        minimum=0.0,
        maximum=2000.0,
    )
    imu_noise: float = parameter(
        0.0,
        doc="Standard deviation of the accelerometer along each axis.",
        unit="m/s^2",
        minimum=0.0,
    )
    imu_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Constant error of the accelerometer, in the body.",
        unit="m/s^2",
        length=3,
    )
    odom_delay: float = parameter(
        0.0,
        doc="Delay from measurement to publication of an odometry.",
        unit="s",
        minimum=0.0,
    )
    odom_stamp: str = parameter(
        "measured",
        doc="Stamp of an odometry: the time of measurement, or of publication, which hides the "
        "delay.",
        choices=("measured", "sent"),
    )
    odom_jitter: float = parameter(
        0.0,
        doc="Standard deviation of the measurement times; stamp and publication move with them, "
        "by at most 0.45 periods.",
        unit="s",
        minimum=0.0,
    )
    odom_dropout: float = parameter(
        0.0,
        doc="Probability that an odometry is lost; the first odometry is never lost.",
        minimum=0.0,
        below=1.0,
    )

    lockstep: bool = parameter(
        False, doc="Simulated time: step only after the command for the last odometry."
    )
    lockstep_timeout: float = parameter(
        20.0,
        doc="Wall-clock timeout of a lockstep step, after mpc and reference have started.",
        unit="s",
        above=0.0,
        advanced=True,
    )
    autostart: bool = parameter(
        True, doc="Start the simulation at once, or with the service ~/start."
    )
    duration: float = parameter(
        0.0, doc="Exit after this time of flight; 0 never exits.", unit="s", minimum=0.0
    )
    obstacles: ObstacleSensorParameters = field(default_factory=ObstacleSensorParameters)

    @classmethod
    def share(cls, common: Mapping[str, object], own: Mapping[str, object]) -> dict[str, object]:
        """Return the parameters of a vehicle file for this plant, without replaced parameters.

        The vehicle's input delay is from the stamp of the odometry to the command's effect.
        """
        share = super().share(common, own)
        entry = plant_entry(str(own.get(cls.choice, "internal")))
        for name in entry.has_own if entry is not None else ():
            share.pop(name, None)
        delay, of_odometry = common.get("input_delay"), own.get("odom_delay", 0.0)
        if isinstance(delay, int | float) and isinstance(of_odometry, int | float):
            share["command_delay"] = max(delay - of_odometry, 0.0)
        return share

    def vehicle_values(self) -> dict[str, Any]:
        """Return the vehicle of this plant under the names of a vehicle file."""
        values = super().vehicle_values()
        has_own = self.entry().has_own
        if "rate_time_constant" not in has_own:
            values["input_delay"] = self.command_delay + self.odom_delay
        return {name: value for name, value in values.items() if name not in has_own}

    def check(self) -> None:
        """Reject parameters that the plant replaces."""
        super().check()
        defaults = {spec.name: spec.default for spec in self.specs()}
        for name in self.entry().has_own:
            if getattr(self, name) != defaults[name]:
                raise ConfigurationError(
                    f"{self.owner}.{name}",
                    getattr(self, name),
                    f"{defaults[name]}: the plant {self.plant} has its own value",
                )

    def entry(self) -> PlantEntry[SimulatorConfig]:
        """Return the entry of the plant."""
        found = plant_entry(self.plant)
        assert found is not None
        return found
