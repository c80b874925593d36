"""Parameters of the Crazyflie bridge."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.ros.bridges.config import EstimatorConfig


@dataclass(frozen=True, kw_only=True)
class CrazyflieLossParameters(Configuration):
    """What the firmware is asked to do when the commands of the MPC stop in flight."""

    owner = "lost"

    after: float = parameter(
        0.15,
        doc="Without a command for so long the firmware is asked to land by itself, if odometry "
        "still comes; it holds the last rates until it is asked, or for 0.5 s.",
        unit="s",
        above=0.0,
        maximum=0.5,
    )
    descent: float = parameter(
        0.3, doc="How fast it then sinks to where it last stood.", unit="m/s", above=0.0
    )


@dataclass(frozen=True, kw_only=True)
class CrazyflieConfig(EstimatorConfig):
    """Parameters of the Crazyflie bridge."""

    owner = "crazyflie_bridge"

    uri: str = parameter(
        "radio://0/80/2M/E7E7E7E7E7",
        doc="Address of the Crazyflie as cflib writes it: radio://, usb:// or udp://.",
    )
    external: str = parameter(
        "pose",
        doc="What of that odometry is sent to the estimator on board: pose, position, or none, "
        "where the estimator on board is its source.",
        choices=("pose", "position", "none"),
    )
    external_rate: float = parameter(50.0, doc="How often.", unit="Hz", minimum=1.0, maximum=200.0)
    lost: CrazyflieLossParameters = dataclasses.field(default_factory=CrazyflieLossParameters)
