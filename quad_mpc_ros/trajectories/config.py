"""Parameters of the reference node."""

from __future__ import annotations

import math
from dataclasses import dataclass

from quad_mpc_ros.configuration import ConfigurationError, ManagedConfiguration, parameter
from quad_mpc_ros.model.vehicle import VehicleParameters

TRAJECTORY_NAMES = (
    "square",
    "hover",
    "waypoints",
    "circle",
    "lemniscate",
    "minimum_snap",
    "vertical_loop",
    "flip",
    "split_s",
    "csv",
    "bag",
)


@dataclass(frozen=True, kw_only=True)
class ReferenceConfig(ManagedConfiguration, VehicleParameters):
    """Which trajectory to fly, within which limits, and how it is published.

    Attitudes and body rates of smooth trajectories are those of the vehicle, which is the paper's
    unless told otherwise; one that it cannot fly is refused.
    """

    owner = "reference"

    trajectory: str = parameter("square", doc="Trajectory to fly.", choices=TRAJECTORY_NAMES)
    mode: str = parameter(
        "at_once",
        doc="at_once: fly the trajectory from the first odometry on; on_request: stand on the "
        "ground until the services of the node say what to fly.",
        choices=("at_once", "on_request"),
    )
    origin: tuple[float, ...] = parameter(
        (0.0, 0.0),
        doc="Where the origin of the trajectory lies, east and north.",
        unit="m",
        length=2,
    )
    height: float = parameter(
        2.0,
        doc="Height of the trajectory above the ground, of its lowest point where it is not "
        "level; not for those that have heights of their own (waypoints, minimum_snap, csv, bag).",
        unit="m",
        minimum=0.0,
    )
    yaw: float = parameter(
        0.0,
        doc="Where the nose points while level, from east to north; vertical_loop, flip and "
        "split_s are flown that way. Added to the yaw of a csv.",
        unit="rad",
        minimum=-math.tau,
        maximum=math.tau,
    )
    time_scaling: str = parameter(
        "none",
        doc="auto: slow down a trajectory that the vehicle cannot fly until it can; none: refuse "
        "it.",
        choices=("none", "auto"),
    )
    throttle_min: float = parameter(
        0.0, doc="Least throttle that a trajectory may need.", minimum=0.0, maximum=1.0
    )
    throttle_max: float = parameter(
        1.0, doc="Most throttle that a trajectory may need.", minimum=0.0, maximum=1.0
    )
    omega_max: tuple[float, ...] = parameter(
        (7.0 * math.pi, 7.0 * math.pi, 3.5 * math.pi),
        doc="Most body rates that a trajectory may need (roll, pitch, yaw); a little above the "
        "bound of the mpc, as a short peak beyond that is still flown.",
        unit="rad/s",
        length=3,
        above=0.0,
    )
    limit_margin: float = parameter(
        0.0,
        doc="Share of the way from hovering to each limit that a trajectory must leave free.",
        minimum=0.0,
        below=1.0,
    )
    side: float = parameter(2.0, doc="square: length of its sides.", unit="m", above=0.0)
    dwell_time: float = parameter(
        2.0,
        doc="square, waypoints: time at each corner or waypoint before the next one.",
        unit="s",
        above=0.0,
    )
    preview: bool = parameter(
        False,
        doc="square, waypoints with legs of jump: show what is ahead; otherwise the present "
        "corner is held over the window. Smooth trajectories always show what is ahead.",
    )
    waypoints: tuple[float, ...] = parameter(
        (0.0, 0.0, 2.0, 2.0, 0.0, 2.0, 2.0, 2.0, 2.0, 0.0, 2.0, 2.0, 0.0, 0.0, 2.0),
        doc="waypoints, minimum_snap: x, y, z of one point after the other, from the origin.",
        unit="m",
        minimum=-1e5,
        maximum=1e5,
    )
    waypoint_legs: str = parameter(
        "minimum_snap",
        doc="waypoints: how to get from one to the next, by a smooth leg or, as the paper's "
        "square does, by a jump.",
        choices=("minimum_snap", "jump"),
    )
    max_speed: float = parameter(
        5.0,
        doc="waypoints, minimum_snap, the ways in and out of csv and bag, and what services and "
        "goals ask for: highest speed.",
        unit="m/s",
        above=0.0,
        maximum=1e3,
    )
    max_acceleration: float = parameter(
        2.0,
        doc="waypoints, minimum_snap, the ways in and out of csv and bag, and what services and "
        "goals ask for: highest acceleration.",
        unit="m/s^2",
        above=0.0,
        maximum=1e3,
    )
    circle_radius: float = parameter(
        2.0, doc="circle: its radius.", unit="m", above=0.0, maximum=1e4
    )
    circle_speed: float = parameter(
        2.0, doc="circle: speed along it.", unit="m/s", above=0.0, maximum=1e3
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
    loop_radius: float = parameter(
        1.5,
        doc="vertical_loop: its radius. split_s: that of its inverted part.",
        unit="m",
        above=0.0,
        maximum=1e3,
    )
    loop_speed: float = parameter(
        5.5,
        doc="vertical_loop: speed at its top, the highest.",
        unit="m/s",
        above=0.0,
        maximum=1e3,
    )
    flip_axis: str = parameter("pitch", doc="flip: axis to turn about.", choices=("pitch", "roll"))
    flip_rate: float = parameter(
        12.0,
        doc="flip, split_s: highest body rate of the turn.",
        unit="rad/s",
        minimum=1.0,
        maximum=1000.0,
    )
    coasting_thrust: float = parameter(
        0.3,
        doc="flip, split_s: thrust over weight while turning over.",
        minimum=0.01,
        maximum=1.0,
    )
    file: str = parameter("", doc="csv: the table to fly. bag: the recorded run to fly again.")
    path_tolerance: float = parameter(
        0.005,
        doc="csv, bag: how far the smooth curve may be from the points, root mean square.",
        unit="m",
        above=0.0,
    )
    takeoff_height: float = parameter(
        1.5,
        doc="Height above the ground to which the service takeoff climbs.",
        unit="m",
        above=0.0,
        maximum=1e3,
    )
    touchdown_speed: float = parameter(
        0.3,
        doc="Speed of a landing from half a metre above the ground until it has been touched.",
        unit="m/s",
        above=0.0,
        maximum=1.0,
    )
    reach: float = parameter(
        100.0,
        doc="How far from where the vehicle stood at first a goal or a trajectory received may "
        "lead.",
        unit="m",
        above=0.0,
        maximum=1e3,
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
        """Refuse limits that forbid hovering, and windows of no or of too many samples."""
        super().check()
        hover = self.vehicle().hover_throttle
        for name, fits in (
            ("throttle_min", self.throttle_min < hover),
            ("throttle_max", self.throttle_max > hover),
        ):
            if not fits:
                side = "below" if name == "throttle_min" else "above"
                raise ConfigurationError(
                    f"{self.owner}.{name}",
                    getattr(self, name),
                    f"a number {side} the hover throttle {hover:.4f}",
                )
        if not self.window_step <= self.window_duration <= 1000 * self.window_step:
            raise ConfigurationError(
                f"{self.owner}.window_step",
                self.window_step,
                f"a number between {self.window_duration / 1000:g} and {self.window_duration:g} "
                "(window_duration in 1 to 1000 steps)",
            )
