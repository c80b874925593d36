"""Parameters of the reference node."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, ConfigurationError, parameter


@dataclass(frozen=True, kw_only=True)
class ReferenceConfig(Configuration):
    """Which trajectory to fly and how it is published."""

    owner = "reference"

    trajectory: str = parameter("square", doc="Trajectory to fly.", choices=("square",))
    side: float = parameter(2.0, doc="square: length of its sides.", unit="m", above=0.0)
    height: float = parameter(2.0, doc="square: height above the ground.", unit="m", minimum=0.0)
    dwell_time: float = parameter(
        2.0, doc="square: time at each corner before the next one.", unit="s", above=0.0
    )
    preview: bool = parameter(
        False, doc="Show what is ahead; otherwise the present reference is held over the window."
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
        if not self.window_step <= self.window_duration <= 1000 * self.window_step:
            raise ConfigurationError(
                f"{self.owner}.window_step",
                self.window_step,
                f"a number between {self.window_duration / 1000:g} and {self.window_duration:g} "
                "(window_duration in 1 to 1000 steps)",
            )
