"""Parameters of the visualisation node."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.model.vehicle import ARM, VehicleParameters


@dataclass(frozen=True, kw_only=True)
class VisualisationConfig(VehicleParameters):
    """What viewers are shown; mass and thrust curve give the thrust that a throttle stands for."""

    owner = "visualisation"

    publish_rate: float = parameter(
        25.0,
        doc="Markers and transforms per second at most.",
        unit="Hz",
        above=0.0,
        maximum=1000.0,
    )
    trail_duration: float = parameter(
        10.0, doc="How long the flown path stays.", unit="s", minimum=0.0, maximum=3600.0
    )
    arm: float = parameter(
        ARM, doc="From the centre of the drawn vehicle to a rotor.", unit="m", above=0.0
    )
    thrust_length: float = parameter(
        0.3, doc="Length of the thrust arrow at hover.", unit="m", above=0.0
    )
    broadcast_tf: bool = parameter(
        True,
        doc="Broadcast the pose of the odometry on /tf, where tf2_msgs is installed; false where "
        "an estimator does.",
    )
