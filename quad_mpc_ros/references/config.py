# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""All trajectories by name, and the parameters of the reference node.

A trajectory is registered here: its name in ``TRAJECTORIES``, and its parameters, if any, as a
base of :class:`ReferenceConfig`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from quad_mpc_ros.configuration import (
    Configuration,
    ConfigurationError,
    ExtensibleConfiguration,
    ManagedConfiguration,
    parameter,
    registered,
)
from quad_mpc_ros.control.model.vehicle import VehicleParameters
from quad_mpc_ros.references.bounds import ReferenceFenceParameters
from quad_mpc_ros.references.ellipse import (
    CircleParameters,
    EllipseParameters,
    circle,
    ellipse,
)
from quad_mpc_ros.references.excitation import ExcitationParameters, excitation
from quad_mpc_ros.references.feasibility import FeasibilityParameters
from quad_mpc_ros.references.lemniscate import LemniscateParameters, lemniscate
from quad_mpc_ros.references.manoeuvres import (
    FlipParameters,
    VerticalLoopParameters,
    flip,
    vertical_loop,
)
from quad_mpc_ros.references.path import Path
from quad_mpc_ros.references.point_table import GateParameters, csv_path, gates_path
from quad_mpc_ros.references.square import SquareParameters, smooth_square, square
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.references.waypoints import (
    WaypointParameters,
    hover,
    through_waypoints,
    waypoints,
)


@dataclass(frozen=True, kw_only=True)
class TrajectoryEntry:
    """Registration of a trajectory.

    Other packages register an entry with an entry point of the group
    ``quad_mpc_ros.trajectories``; ``parameters`` is the class of the trajectory's parameters.

    ``make`` returns a path, which is flown by differential flatness, or a trajectory. ``joined``
    returns a path without jumps instead of a trajectory with jumps. ``scalable`` is false for
    manoeuvres that depend on gravity and cannot be slowed down.
    """

    make: Callable[[Any], Path | Trajectory]
    parameters: type[Configuration] | None = None
    joined: Callable[[Any], Path] | None = None
    scalable: bool = True


TRAJECTORIES = {
    "square": TrajectoryEntry(make=square, joined=smooth_square),
    "hover": TrajectoryEntry(make=hover),
    "waypoints": TrajectoryEntry(make=waypoints),
    "circle": TrajectoryEntry(make=circle),
    "ellipse": TrajectoryEntry(make=ellipse),
    "lemniscate": TrajectoryEntry(make=lemniscate),
    "minimum_snap": TrajectoryEntry(make=through_waypoints),
    "vertical_loop": TrajectoryEntry(make=vertical_loop, scalable=False),
    "flip": TrajectoryEntry(make=flip, scalable=False),
    "excitation": TrajectoryEntry(make=excitation),
    "csv": TrajectoryEntry(make=csv_path),
    "gates": TrajectoryEntry(make=gates_path),
}


@dataclass(frozen=True, kw_only=True)
class TrajectoryChoiceParameters(ExtensibleConfiguration, ManagedConfiguration, VehicleParameters):
    """Selection of the trajectory and of its start."""

    owner = "reference"
    choice = "trajectory"
    group = "quad_mpc_ros.trajectories"

    trajectory: str = parameter("square", doc="Trajectory to fly.", choices=tuple(TRAJECTORIES))
    mode: str = parameter(
        "at_once",
        doc="at_once: start the trajectory at the first odometry; on_request: idle on the "
        "ground until a service is called.",
        choices=("at_once", "on_request"),
    )


# The parameters are listed in the order of the bases, the last one first.
@dataclass(frozen=True, kw_only=True)
class ReferenceConfig(
    GateParameters,
    ExcitationParameters,
    FlipParameters,
    VerticalLoopParameters,
    LemniscateParameters,
    EllipseParameters,
    CircleParameters,
    WaypointParameters,
    SquareParameters,
    FeasibilityParameters,
    TrajectoryChoiceParameters,
):
    """Trajectory, limits and publication of the reference.

    Attitudes and body rates of smooth trajectories are computed for the configured vehicle, by
    default the paper's; infeasible trajectories are rejected.
    """

    takeoff_height: float = parameter(
        1.5,
        doc="Height above the ground to which the service takeoff climbs.",
        unit="m",
        above=0.0,
        maximum=1e3,
    )
    takeoff_check: bool = parameter(
        True,
        doc="Whether a take-off circles once with a radius of 3 cm, 0.25 m above the ground, so "
        "that the MPC detects wrong axes of the odometry before the vehicle climbs.",
    )
    touchdown_speed: float = parameter(
        0.3,
        doc="Speed of a landing from half a metre above the ground to the touchdown.",
        unit="m/s",
        above=0.0,
        maximum=1.0,
    )
    velocity_timeout: float = parameter(
        0.5,
        doc="Duration of a commanded velocity; without a newer command the vehicle then brakes "
        "and hovers.",
        unit="s",
        above=0.0,
        maximum=10.0,
    )
    fence: ReferenceFenceParameters = field(default_factory=ReferenceFenceParameters)
    reach: float = parameter(
        100.0,
        doc="Largest distance of a goal, a received trajectory or, along each axis, a velocity "
        "command from the first position.",
        unit="m",
        above=0.0,
        maximum=1e3,
        advanced=True,
    )
    publish_rate: float = parameter(
        50.0,
        doc="Largest rate of windows: one is published when the reference changes, otherwise "
        "after a twentieth of window_duration; in lockstep one per odometry.",
        unit="Hz",
        above=0.0,
        advanced=True,
    )
    window_duration: float = parameter(
        2.0,
        doc="Duration of a window; at least 1.1 times the horizon of the MPC.",
        unit="s",
        above=0.0,
        advanced=True,
    )
    window_step: float = parameter(
        0.05, doc="Time between the samples of a window.", unit="s", above=0.0, advanced=True
    )
    frame_id: str = parameter("odom", doc="World frame of the trajectory.")
    lockstep: bool = parameter(
        False, doc="Publish one window per odometry, with the odometry's stamp, in simulated time."
    )

    def check(self) -> None:
        """Reject windows with no or too many samples."""
        super().check()
        if not self.window_step <= self.window_duration <= 1000 * self.window_step:
            raise ConfigurationError(
                f"{self.owner}.advanced.window_step",
                self.window_step,
                f"a number between {self.window_duration / 1000:g} and {self.window_duration:g} "
                "(window_duration in 1 to 1000 steps)",
            )

    @property
    def renewal_period(self) -> float:
        """Time [s] after which an unchanged window is published again."""
        return 0.05 * self.window_duration

    def entry(self) -> TrajectoryEntry:
        """Return the entry of the trajectory."""
        found = TRAJECTORIES.get(self.trajectory) or registered(self.group, self.trajectory)
        assert isinstance(found, TrajectoryEntry)
        return found
