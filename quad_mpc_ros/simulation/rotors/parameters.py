# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the plant ``rotors``, in addition to the common parameters.

The defaults describe the paper's quadrotor. ``config/vehicles/paper.yaml`` gives the source of the
numbers that are not in the paper.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import Configuration, ConfigurationError, parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.parameters import PlantParameters

_ARM = 0.0778  # m along x and along y: 220 mm from rotor to rotor across


def inertia_tensor(entries: tuple[float, ...]) -> Array:
    """Return the tensor (3, 3) with the entries xx, yy, zz, xy, xz, yz [kg m^2]."""
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@dataclass(frozen=True, kw_only=True)
class RotorParameters(Configuration):
    """Positions of the rotors, and the coefficients that all rotors share."""

    owner = "simulator.rotors"

    x: tuple[float, ...] = parameter(
        (_ARM, -_ARM, -_ARM, _ARM),
        doc="Positions of the rotors along body x, forwards.",
        unit="m",
    )
    y: tuple[float, ...] = parameter(
        (_ARM, _ARM, -_ARM, -_ARM), doc="Positions of the rotors along body y, left.", unit="m"
    )
    z: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0, 0.0), doc="Positions of the rotors along body z, up.", unit="m"
    )
    spin: tuple[float, ...] = parameter(
        (-1.0, 1.0, -1.0, 1.0),
        doc="Spin direction of each rotor: 1 anticlockwise from above, or -1.",
    )
    thrust_coefficient: float = parameter(
        1.21e-6, doc="Thrust per squared rotor speed.", unit="N s^2", above=0.0
    )
    torque_coefficient: float = parameter(
        1.83e-9, doc="Drag torque per squared rotor speed.", unit="N m s^2", above=0.0
    )
    time_constant: float = parameter(
        0.02, doc="First-order lag of the speed.", unit="s", minimum=1e-3, maximum=1.0
    )
    inertia: float = parameter(
        0.0,
        doc="Inertia of a rotor about its axis, motor bell included.",
        unit="kg m^2",
        minimum=0.0,
    )
    speed_min: float = parameter(
        0.0, doc="Minimum speed, at which the rotors idle.", unit="rad/s", minimum=0.0
    )
    speed_max: float = parameter(
        1966.0, doc="Maximum speed, with a full battery.", unit="rad/s", above=0.0
    )
    inflow_loss: float = parameter(
        0.0,
        doc="Thrust loss divided by rotor speed and axial airspeed.",
        unit="N s^2/(rad m)",
        minimum=0.0,
    )
    drag: float = parameter(
        0.0,
        doc="Drag force of a rotor divided by rotor speed and lateral airspeed.",
        unit="N s^2/(rad m)",
        minimum=0.0,
    )
    radius: float = parameter(
        0.0635, doc="Radius of a rotor, for ground effect.", unit="m", above=0.0
    )

    def check(self) -> None:
        """Reject lists of unequal length, spins other than 1 and -1, and no speed range."""
        for name in ("y", "z", "spin"):
            if len(getattr(self, name)) != len(self.x) or not self.x:
                raise ConfigurationError(
                    f"{self.owner}.{name}", getattr(self, name), f"{len(self.x)} numbers, like x"
                )
        if not set(self.spin) <= {1.0, -1.0}:
            raise ConfigurationError(f"{self.owner}.spin", self.spin, "numbers 1 or -1")
        if self.speed_min >= self.speed_max:
            raise ConfigurationError(
                f"{self.owner}.speed_min", self.speed_min, f"a speed below {self.speed_max:g}"
            )


@dataclass(frozen=True, kw_only=True)
class AirframeParameters(Configuration):
    """The body: inertia, centre of mass, drag and ground effect."""

    owner = "simulator.airframe"

    inertia: tuple[float, ...] = parameter(
        (8.2e-4, 6.9e-4, 1.41e-3, 0.0, 0.0, 0.0),
        doc="Inertia about the centre of mass, entries xx, yy, zz, xy, xz, yz of the tensor.",
        unit="kg m^2",
        length=6,
    )
    center_of_mass: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Centre of mass in the body; the autopilot assumes it at the origin.",
        unit="m",
        length=3,
    )
    drag_linear: tuple[float, ...] = parameter(
        (0.0794, 0.0794, 0.0794),
        doc="Drag divided by velocity along each body axis.",
        unit="kg/s",
        length=3,
        minimum=0.0,
    )
    drag_quadratic: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Drag divided by speed times velocity along each body axis.",
        unit="kg/m",
        length=3,
        minimum=0.0,
    )
    translational_lift: float = parameter(
        0.0,
        doc="Lift of all rotors divided by the square of the lateral airspeed; k_h.",
        unit="kg/m",
        minimum=0.0,
    )
    ground_effect: float = parameter(
        0.0,
        doc="Strength of the ground effect: 1 as measured by Cheeseman and Bennett, 0 none.",
        minimum=0.0,
    )
    clearance: float = parameter(
        0.05,
        doc="Height of the body's origin above the ground at rest.",
        unit="m",
        minimum=0.0,
    )

    def check(self) -> None:
        """Reject a tensor that is not positive definite."""
        if np.linalg.eigvalsh(inertia_tensor(self.inertia)).min() <= 0.0:
            raise ConfigurationError(
                f"{self.owner}.inertia",
                self.inertia,
                "a positive definite tensor xx, yy, zz, xy, xz, yz",
            )


@dataclass(frozen=True, kw_only=True)
class RateLoopParameters(Configuration):
    """The autopilot's rate loop and its mixer.

    The gains compute an angular acceleration; the diagonal of the inertia converts it to torque.
    """

    owner = "simulator.rate_loop"

    rate: float = parameter(
        1000.0, doc="Rate of the rate loop.", unit="Hz", minimum=50.0, maximum=8000.0
    )
    p: tuple[float, ...] = parameter(
        (60.0, 60.0, 6.0),
        doc="Gain from the rate error of each axis to angular acceleration.",
        unit="1/s",
        length=3,
        minimum=0.0,
    )
    i: tuple[float, ...] = parameter(
        (60.0, 60.0, 6.0),
        doc="Gain from the integral of the rate error to angular acceleration.",
        unit="1/s^2",
        length=3,
        minimum=0.0,
    )
    d: tuple[float, ...] = parameter(
        (0.6, 0.6, 0.0),
        doc="Gain from the derivative of the filtered gyro to angular acceleration.",
        length=3,
        minimum=0.0,
    )
    integral_max: tuple[float, ...] = parameter(
        (100.0, 100.0, 10.0),
        doc="Limit of the integral's angular acceleration.",
        unit="rad/s^2",
        length=3,
        minimum=0.0,
    )
    torque_max: tuple[float, ...] = parameter(
        (0.5, 0.5, 0.02),
        doc="Limit of the torque demand about each axis.",
        unit="N m",
        length=3,
        above=0.0,
    )
    gyro_cutoff: float = parameter(
        0.0,
        doc="Cut-off of the gyro filter, a second-order Butterworth; 0 disables the filter.",
        unit="Hz",
        minimum=0.0,
    )
    d_cutoff: float = parameter(
        80.0,
        doc="Cut-off of the first-order filter of the D term; 0 disables the filter.",
        unit="Hz",
        minimum=0.0,
    )

    def check(self) -> None:
        """Reject cut-offs above half of the rate."""
        for name in ("gyro_cutoff", "d_cutoff"):
            if getattr(self, name) >= 0.5 * self.rate:
                raise ConfigurationError(
                    f"{self.owner}.{name}",
                    getattr(self, name),
                    f"less than half of {self.rate:g} Hz",
                )


@dataclass(frozen=True, kw_only=True)
class BatteryParameters(Configuration):
    """A battery whose voltage, and with it the rotor speed, falls with current and used charge."""

    owner = "simulator.battery"

    capacity: float = parameter(
        0.0, doc="Capacity; 0 is a battery with constant voltage.", unit="A h", minimum=0.0
    )
    charge: float = parameter(1.0, doc="State of charge at the start.", minimum=0.0, maximum=1.0)
    voltage_full: float = parameter(
        16.8, doc="Voltage of a full battery without current.", unit="V", above=0.0
    )
    voltage_empty: float = parameter(
        13.2,
        doc="Voltage of an empty battery without current; linear in between.",
        unit="V",
        above=0.0,
    )
    resistance: float = parameter(0.02, doc="Internal resistance.", unit="ohm", minimum=0.0)
    efficiency: float = parameter(
        0.7, doc="Ratio of rotor power to battery power.", above=0.0, maximum=1.0
    )
    compensated: bool = parameter(
        False,
        doc="Whether the autopilot compensates the voltage in its outputs; the maximum speed "
        "still falls.",
    )

    def check(self) -> None:
        """Reject an empty battery with a higher voltage than a full battery."""
        if self.voltage_empty > self.voltage_full:
            raise ConfigurationError(
                f"{self.owner}.voltage_empty", self.voltage_empty, f"at most {self.voltage_full:g}"
            )


@dataclass(frozen=True, kw_only=True)
class PushParameters(Configuration):
    """An external force for a limited time."""

    owner = "simulator.push"

    force: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="External force at the centre of mass, in the world; only with the plant rotors.",
        unit="N",
        length=3,
    )
    begin: float = parameter(0.0, doc="Start time of the force.", unit="s", minimum=0.0)
    duration: float = parameter(
        0.0, doc="Duration of the force; 0 lasts until the end.", unit="s", minimum=0.0
    )


@dataclass(frozen=True, kw_only=True)
class RotorsPlantParameters(PlantParameters):
    """The parameters of the plant ``rotors``, in groups."""

    rotors: RotorParameters = dataclasses.field(default_factory=RotorParameters)
    airframe: AirframeParameters = dataclasses.field(default_factory=AirframeParameters)
    rate_loop: RateLoopParameters = dataclasses.field(default_factory=RateLoopParameters)
    battery: BatteryParameters = dataclasses.field(default_factory=BatteryParameters)
    push: PushParameters = dataclasses.field(default_factory=PushParameters)
