"""Parameters of the simulator node."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.model.vehicle import Vehicle, VehicleParameters

# Above this deviation of its length from 1 a quaternion is a mistake and not a rounded one.
_QUATERNION_TOLERANCE = 1e-3
_LONGEST_TIME_CONSTANT = 10.0


@dataclass(frozen=True, kw_only=True)
class SimulatorConfig(VehicleParameters):
    """The plant, on parameters of its own so that it can differ from the controller's model.

    By default it has no lag, delay, wind, noise or losses.
    """

    owner = "simulator"

    plant: str = parameter(
        "internal",
        doc="What flies: the package's own vehicle, or the Hummingbird of rotorpy (optional).",
        choices=("internal", "rotorpy"),
    )
    dynamics: str = parameter(
        "rigid_body",
        doc="Equations of motion: the true rigid body, or the paper's Eq. (3) literally.",
        choices=("rigid_body", "paper"),
    )
    odom_rate: float = parameter(50.0, doc="Odometry messages per second.", unit="Hz", above=0.0)
    integration_step: float = parameter(
        0.005, doc="Longest step of the integrator.", unit="s", minimum=1e-5, maximum=0.05
    )
    rotorpy_rate_gain: float = parameter(
        20.0,
        doc="Gain k_w of rotorpy's body-rate loop; the reciprocal is nearly its time constant.",
        unit="1/s",
        above=0.0,
    )

    mass_scale: float = parameter(1.0, doc="True mass over the parameter mass.", above=0.0)
    thrust_scale: float = parameter(1.0, doc="True thrust over that of the curve.", above=0.0)

    rate_time_constant: float = parameter(
        0.0,
        doc="First-order lag of the body rates behind the commanded ones.",
        unit="s",
        minimum=0.0,
        maximum=_LONGEST_TIME_CONSTANT,
    )
    thrust_time_constant: float = parameter(
        0.0,
        doc="First-order lag of the throttle that makes the thrust behind the commanded one.",
        unit="s",
        minimum=0.0,
        maximum=_LONGEST_TIME_CONSTANT,
    )
    command_delay: float = parameter(
        0.0, doc="Time from the arrival of a command to its effect.", unit="s", minimum=0.0
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

    position_noise: float = parameter(
        0.0, doc="Standard deviation of the odometry's position.", unit="m", minimum=0.0
    )
    attitude_noise: float = parameter(
        0.0,
        doc="Standard deviation of its attitude about each body axis.",
        unit="rad",
        minimum=0.0,
    )
    velocity_noise: float = parameter(
        0.0, doc="Standard deviation of its velocity.", unit="m/s", minimum=0.0
    )
    rate_noise: float = parameter(
        0.0, doc="Standard deviation of its body rates.", unit="rad/s", minimum=0.0
    )
    position_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Error of the odometry's position, in the world.", unit="m", length=3
    )
    velocity_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Error of its velocity, in the body.", unit="m/s", length=3
    )
    attitude_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Error of its attitude, a rotation vector in the body.",
        unit="rad",
        length=3,
    )
    odom_delay: float = parameter(
        0.0,
        doc="Time from a measurement, whose stamp the odometry carries, to its sending.",
        unit="s",
        minimum=0.0,
    )
    odom_jitter: float = parameter(
        0.0,
        doc="Standard deviation of the times of the odometries about their regular times; "
        "measurement, stamp and sending move together, by at most 0.45 periods.",
        unit="s",
        minimum=0.0,
    )
    odom_dropout: float = parameter(
        0.0,
        doc="Probability that an odometry is not sent; the first one always is.",
        minimum=0.0,
        below=1.0,
    )
    seed: int = parameter(0, doc="Seed of gusts, noise, jitter and drop-outs.", minimum=0)

    initial_position: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Where the vehicle starts.", unit="m", length=3
    )
    initial_velocity: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Velocity at the start, in the world.", unit="m/s", length=3
    )
    initial_attitude: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0, 1.0),
        doc="Attitude at the start, quaternion x, y, z, w of body to world; level, heading east.",
        length=4,
    )
    initial_body_rates: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        doc="Body rates at the start, held until the first command acts.",
        unit="rad/s",
        length=3,
    )
    initial_throttle: float = parameter(
        0.0,
        doc="Throttle at the start, held until the first command acts.",
        minimum=0.0,
        maximum=1.0,
    )

    lockstep: bool = parameter(
        False, doc="Simulated time: step only when the command for the last odometry has come."
    )
    lockstep_timeout: float = parameter(
        20.0, doc="How long to wait in lockstep before giving up, wall clock.", unit="s", above=0.0
    )
    autostart: bool = parameter(
        True, doc="Start the clock at once; otherwise the service ~/start does."
    )
    duration: float = parameter(
        0.0, doc="Stop and exit after this much flight; 0 is never.", unit="s", minimum=0.0
    )
    frame_id: str = parameter("odom", doc="World frame of the odometry.")
    child_frame_id: str = parameter("base_link", doc="Body frame of the odometry.")

    def check(self) -> None:
        """Refuse a start below the ground and an attitude that is none."""
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
        if self.plant == "rotorpy":
            self._check_rotorpy()

    def _check_rotorpy(self) -> None:
        """Refuse what rotorpy has of its own."""
        own: dict[str, object] = {
            "dynamics": "rigid_body",
            "rate_time_constant": 0.0,
            "thrust_time_constant": 0.0,
        }
        for name, only in own.items():
            if getattr(self, name) != only:
                raise ConfigurationError(
                    f"{self.owner}.{name}",
                    getattr(self, name),
                    f"{only}: the plant rotorpy has its own",
                )

    def vehicle(self) -> Vehicle:
        """Return the true vehicle."""
        nominal = super().vehicle()
        a, b, c = (self.thrust_scale * coefficient for coefficient in self.thrust_curve)
        return dataclasses.replace(
            nominal, mass=self.mass * self.mass_scale, thrust_curve=(a, b, c)
        )
