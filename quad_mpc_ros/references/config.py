"""Parameters of the reference node."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.core.vehicle import VehicleParameters


@dataclass(frozen=True, kw_only=True)
class ReferenceConfig(VehicleParameters):
    """Which trajectory to fly and how it is published.

    Attitudes and body rates of smooth trajectories are those of the vehicle, which is the paper's
    unless told otherwise; one that its motors cannot fly is refused.
    """

    owner = "reference"

    trajectory: str = parameter(
        "square", doc="Trajectory to fly.", choices=("square", "hover", "lemniscate")
    )
    origin: tuple[float, ...] = parameter(
        (0.0, 0.0),
        doc="Where the origin of the trajectory lies, east and north.",
        unit="m",
        length=2,
    )
    height: float = parameter(
        2.0, doc="Height of the trajectory above the ground.", unit="m", minimum=0.0
    )
    side: float = parameter(2.0, doc="square: length of its sides.", unit="m", above=0.0)
    dwell_time: float = parameter(
        2.0, doc="square: time at each corner before the next one.", unit="s", above=0.0
    )
    preview: bool = parameter(
        False,
        doc="square: show what is ahead; otherwise the present corner is held over the window. "
        "Smooth trajectories (hover, lemniscate) always show what is ahead.",
    )
    amplitude_x: float = parameter(
        3.0, doc="lemniscate: largest distance east of its origin.", unit="m", minimum=0.0
    )
    amplitude_y: float = parameter(
        1.5, doc="lemniscate: largest distance north of its origin.", unit="m", minimum=0.0
    )
    angular_frequency: float = parameter(
        1.0,
        doc="lemniscate: angle of its eastward oscillation per time; northward it is twice that.",
        unit="rad/s",
        minimum=0.001,
    )
    publish_rate: float = parameter(
        50.0, doc="Windows per second; in lockstep one per odometry.", unit="Hz", above=0.0
    )
    window_duration: float = parameter(
        2.0, doc="How far a window reaches; at least the horizon of the MPC.", unit="s", above=0.0
    )
    window_step: float = parameter(
        0.05, doc="Time between the samples of a window.", unit="s", above=0.0
    )
    frame_id: str = parameter("odom", doc="World frame of the trajectory.")
    lockstep: bool = parameter(
        False, doc="Publish one window per odometry, with its stamp, in simulated time."
    )

    def check(self) -> None:
        """Refuse a window without room for a step, or of too many samples for a message."""
        super().check()
        if not self.window_step <= self.window_duration <= 1000 * self.window_step:
            raise ConfigurationError(
                f"{self.owner}.window_step",
                self.window_step,
                f"a number between {self.window_duration / 1000:g} and {self.window_duration:g} "
                "(window_duration in 1 to 1000 steps)",
            )
