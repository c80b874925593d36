"""Parameters of the simulator node."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.core.vehicle import Vehicle, VehicleParameters


@dataclass(frozen=True, kw_only=True)
class SimulatorConfig(VehicleParameters):
    """The plant, on parameters of its own so that it can differ from the controller's model."""

    owner = "simulator"

    dynamics: str = parameter(
        "rigid_body",
        doc="Equations of motion: the true rigid body, or the paper's Eq. (3) literally.",
        choices=("rigid_body", "paper"),
    )
    odom_rate: float = parameter(50.0, doc="Odometry messages per second.", unit="Hz", above=0.0)
    integration_step: float = parameter(
        0.005, doc="Longest step of the integrator.", unit="s", minimum=1e-5, maximum=0.05
    )
    mass_scale: float = parameter(1.0, doc="True mass over the parameter mass.", above=0.0)
    initial_position: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), doc="Where the vehicle starts, at rest and level.", unit="m", length=3
    )
    initial_yaw: float = parameter(0.0, doc="Heading at the start, 0 is east.", unit="rad")
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
        """Refuse a start below the ground."""
        super().check()
        self.check_hover("mass_scale", self.mass_scale, self.mass * self.mass_scale)
        if self.initial_position[2] < 0.0:
            raise ConfigurationError(
                f"{self.owner}.initial_position",
                self.initial_position,
                "3 numbers, the height (third) >= 0",
            )

    def vehicle(self) -> Vehicle:
        """Return the true vehicle."""
        return dataclasses.replace(super().vehicle(), mass=self.mass * self.mass_scale)
