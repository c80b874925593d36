"""The parameters of the plant ``rotors``, in addition to those of every plant.

By default it is the paper's quadrotor; what the paper does not say is as ``config/vehicles``
says where it is from.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, ConfigurationError, parameter
from quad_mpc_ros.simulation.parameters import PlantParameters

_ARM = 0.0778  # m along x and along y: 220 mm from rotor to rotor across


@dataclass(frozen=True, kw_only=True)
class RotorParameters(Configuration):
    """Where the rotors are, and what they make of their speed. One number each, all alike."""

    owner = "simulator.rotors"

    x: tuple[float, ...] = parameter(
        (_ARM, -_ARM, -_ARM, _ARM),
        doc="Places of the rotors in the body, forwards.",
        unit="m",
    )
    y: tuple[float, ...] = parameter(
        (_ARM, _ARM, -_ARM, -_ARM), doc="Places of the rotors in the body, left.", unit="m"
    )
    z: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0, 0.0), doc="Places of the rotors in the body, up.", unit="m"
    )
    tilt_x: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0, 0.0),
        doc="Tilts of the rotors' axes: the rotation vector (tilt_x, tilt_y, 0) turns body z to "
        "the direction of thrust.",
        unit="rad",
    )
    tilt_y: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0, 0.0), doc="Tilts of the rotors' axes, about y.", unit="rad"
    )
    spin: tuple[float, ...] = parameter(
        (-1.0, 1.0, -1.0, 1.0),
        doc="Sense in which each turns about its thrust: 1 anticlockwise from above, or -1.",
    )
    thrust_coefficient: float = parameter(
        1.21e-6, doc="Thrust over the square of the speed.", unit="N s^2", above=0.0
    )
    torque_coefficient: float = parameter(
        1.83e-9, doc="Drag torque over the square of the speed.", unit="N m s^2", above=0.0
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
        0.0, doc="Least speed, at which the rotors idle.", unit="rad/s", minimum=0.0
    )
    speed_max: float = parameter(
        1966.0, doc="Greatest speed, with a full battery.", unit="rad/s", above=0.0
    )
    inflow_loss: float = parameter(
        0.0,
        doc="Thrust lost over speed and axial velocity through the air.",
        unit="N s^2/(rad m)",
        minimum=0.0,
    )
    drag: float = parameter(
        0.0,
        doc="Force of a rotor against its lateral velocity through the air, over both.",
        unit="N s^2/(rad m)",
        minimum=0.0,
    )
    radius: float = parameter(
        0.0635, doc="Radius of a rotor, for ground effect.", unit="m", above=0.0
    )

    def check(self) -> None:
        """Refuse lists of different lengths, senses other than 1 and -1, and no range of speed."""
        for name in ("y", "z", "tilt_x", "tilt_y", "spin"):
            if len(getattr(self, name)) != len(self.x) or not self.x:
                raise ConfigurationError(
                    f"{self.owner}.{name}", getattr(self, name), f"{len(self.x)} numbers, as x has"
                )
        if not set(self.spin) <= {1.0, -1.0}:
            raise ConfigurationError(f"{self.owner}.spin", self.spin, "numbers 1 or -1")
        if self.speed_min >= self.speed_max:
            raise ConfigurationError(
                f"{self.owner}.speed_min", self.speed_min, f"a speed below {self.speed_max:g}"
            )


@dataclass(frozen=True, kw_only=True)
class AirframeParameters(Configuration):
    """The body that the rotors carry: inertia, centre of mass, drag, ground."""

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
        doc="Drag over velocity along each body axis.",
        unit="kg/s",
        length=3,
        minimum=0.0,
    )
    drag_quadratic: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Drag over speed times velocity along each body axis.",
        unit="kg/m",
        length=3,
        minimum=0.0,
    )
    translational_lift: float = parameter(
        0.0,
        doc="Lift over the square of the velocity across the rotors' axes, of all together; k_h.",
        unit="kg/m",
        minimum=0.0,
    )
    ground_effect: float = parameter(
        0.0,
        doc="Strength of ground effect: 1 as Cheeseman and Bennett found it, 0 none.",
        minimum=0.0,
    )
    ground_effect_max: float = parameter(
        1.5, doc="Most that ground effect multiplies thrust by.", minimum=1.0
    )
    clearance: float = parameter(
        0.05,
        doc="Height of the body's origin above the ground when it stands.",
        unit="m",
        minimum=0.0,
    )

    def check(self) -> None:
        """Refuse a tensor that no body has."""
        xx, yy, zz, xy, xz, yz = self.inertia
        determinant = (
            xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        )
        if not (xx > 0.0 and xx * yy > xy * xy and determinant > 0.0):
            raise ConfigurationError(
                f"{self.owner}.inertia",
                self.inertia,
                "a positive definite tensor xx, yy, zz, xy, xz, yz",
            )


@dataclass(frozen=True, kw_only=True)
class RateLoopParameters(Configuration):
    """The autopilot's rate loop and its mixer.

    Gains make angular acceleration, which the diagonal of the inertia turns into torque.
    """

    owner = "simulator.rate_loop"

    rate: float = parameter(
        1000.0, doc="How often the rate loop runs.", unit="Hz", minimum=50.0, maximum=8000.0
    )
    p: tuple[float, ...] = parameter(
        (60.0, 60.0, 6.0),
        doc="Angular acceleration over the error of the rate, each axis.",
        unit="1/s",
        length=3,
        minimum=0.0,
    )
    i: tuple[float, ...] = parameter(
        (60.0, 60.0, 6.0),
        doc="Angular acceleration over the integral of the error.",
        unit="1/s^2",
        length=3,
        minimum=0.0,
    )
    d: tuple[float, ...] = parameter(
        (0.6, 0.6, 0.0),
        doc="Angular acceleration against that of the filtered gyro.",
        length=3,
        minimum=0.0,
    )
    feed_forward: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Angular acceleration over the commanded rate.",
        unit="1/s",
        length=3,
        minimum=0.0,
    )
    integral_max: tuple[float, ...] = parameter(
        (100.0, 100.0, 10.0),
        doc="Most angular acceleration that the integral makes.",
        unit="rad/s^2",
        length=3,
        minimum=0.0,
    )
    torque_max: tuple[float, ...] = parameter(
        (0.5, 0.5, 0.02),
        doc="Most torque that is asked of the mixer about each axis.",
        unit="N m",
        length=3,
        above=0.0,
    )
    gyro_cutoff: float = parameter(
        0.0,
        doc="Cut-off of the gyro's filter, Butterworth of second order; 0 is none.",
        unit="Hz",
        minimum=0.0,
    )
    d_cutoff: float = parameter(
        80.0, doc="Cut-off of the D term's filter, first order; 0 is none.", unit="Hz", minimum=0.0
    )
    airmode: bool = parameter(
        True,
        doc="Where rotors saturate, torque goes before thrust; false keeps the thrust and scales "
        "the torque.",
    )

    def check(self) -> None:
        """Refuse filters that the rate cannot have."""
        for name in ("gyro_cutoff", "d_cutoff"):
            if getattr(self, name) >= 0.5 * self.rate:
                raise ConfigurationError(
                    f"{self.owner}.{name}",
                    getattr(self, name),
                    f"less than half of {self.rate:g} Hz",
                )


@dataclass(frozen=True, kw_only=True)
class BatteryParameters(Configuration):
    """A battery that sags under current and as it is used up; the rotors' speed goes with it."""

    owner = "simulator.battery"

    capacity: float = parameter(
        0.0, doc="Charge of a full battery; 0 is one that never sags.", unit="A h", minimum=0.0
    )
    charge: float = parameter(
        1.0, doc="Share of the charge at the start.", minimum=0.0, maximum=1.0
    )
    voltage_full: float = parameter(
        16.8, doc="Voltage of a full battery without current.", unit="V", above=0.0
    )
    voltage_empty: float = parameter(
        13.2,
        doc="Voltage of an empty one without current; in between it is linear.",
        unit="V",
        above=0.0,
    )
    resistance: float = parameter(0.02, doc="Internal resistance.", unit="ohm", minimum=0.0)
    efficiency: float = parameter(
        0.7, doc="Power of the rotors over that of the battery.", above=0.0, maximum=1.0
    )
    compensated: bool = parameter(
        False,
        doc="Whether the autopilot raises its outputs as the voltage falls; the greatest speed "
        "falls all the same.",
    )

    def check(self) -> None:
        """Refuse a voltage that rises as the battery is used up."""
        if self.voltage_empty > self.voltage_full:
            raise ConfigurationError(
                f"{self.owner}.voltage_empty", self.voltage_empty, f"at most {self.voltage_full:g}"
            )


@dataclass(frozen=True, kw_only=True)
class PushParameters(Configuration):
    """A force from outside for some time."""

    owner = "simulator.push"

    force: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Force that pushes at the centre of mass, in the world; the plant rotors alone.",
        unit="N",
        length=3,
    )
    begin: float = parameter(0.0, doc="When it begins.", unit="s", minimum=0.0)
    duration: float = parameter(
        0.0, doc="How long it pushes; 0 is to the end.", unit="s", minimum=0.0
    )


@dataclass(frozen=True, kw_only=True)
class RotorsPlantParameters(PlantParameters):
    """Its own, in groups."""

    rotors: RotorParameters = dataclasses.field(default_factory=RotorParameters)
    airframe: AirframeParameters = dataclasses.field(default_factory=AirframeParameters)
    rate_loop: RateLoopParameters = dataclasses.field(default_factory=RateLoopParameters)
    battery: BatteryParameters = dataclasses.field(default_factory=BatteryParameters)
    push: PushParameters = dataclasses.field(default_factory=PushParameters)
