"""Parameters of the Crazyflie bridge."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.ros.bridges.config import EstimatorConfig


@dataclass(frozen=True, kw_only=True)
class CrazyflieLossParameters(Configuration):
    """Landing by the firmware when the MPC's commands stop in flight."""

    owner = "lost"

    after: float = parameter(
        0.15,
        doc="Time without commands after which the bridge requests landing, if odometry still "
        "arrives. Until then, and for at most 0.5 s, the firmware holds the last rates.",
        unit="s",
        above=0.0,
        maximum=0.5,
    )
    descent: float = parameter(
        0.3, doc="Descent speed, down to the last height on the ground.", unit="m/s", above=0.0
    )


@dataclass(frozen=True, kw_only=True)
class CrazyflieConfig(EstimatorConfig):
    """Parameters of the Crazyflie bridge."""

    owner = "crazyflie_bridge"

    uri: str = parameter(
        "radio://0/80/2M/E7E7E7E7E7",
        doc="Address of the Crazyflie in cflib's format: radio://, usb:// or udp://.",
    )
    external: str = parameter(
        "pose",
        doc="Part of the odometry that is sent to the onboard estimator: pose, position, or none "
        "if the onboard estimator is the source of the odometry.",
        choices=("pose", "position", "none"),
    )
    external_rate: float = parameter(
        50.0, doc="Rate of external poses.", unit="Hz", minimum=1.0, maximum=200.0
    )
    lost: CrazyflieLossParameters = dataclasses.field(default_factory=CrazyflieLossParameters)
