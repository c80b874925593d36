"""Parameters of the Betaflight bridge."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.ros.bridges.config import EstimatorConfig


@dataclass(frozen=True, kw_only=True)
class BetaflightLossParameters(Configuration):
    """Behaviour if the MPC's commands stop in flight."""

    owner = "lost"

    after: float = parameter(
        0.15,
        doc="Time without commands after which the commands count as lost.",
        unit="s",
        above=0.0,
        maximum=0.5,
    )
    thrust: float = parameter(
        0.85, doc="Thrust-to-weight ratio of the level descent.", minimum=0.0, maximum=1.0
    )
    duration: float = parameter(
        3.0, doc="Duration of the descent before disarming.", unit="s", minimum=0.0, maximum=60.0
    )
    level_gain: float = parameter(
        4.0, doc="Gain from tilt to commanded body rate.", unit="1/s", minimum=0.0, maximum=20.0
    )


@dataclass(frozen=True, kw_only=True)
class BetaflightConfig(EstimatorConfig):
    """Parameters of the Betaflight bridge."""

    owner = "betaflight_bridge"

    device: str = parameter("/dev/ttyAMA0", doc="Serial port to the flight controller.")
    baud: int = parameter(
        115200, doc="Baud rate of the serial port.", unit="bit/s", minimum=9600, maximum=4000000
    )
    receiver: str = parameter(
        "pilot",
        doc="pilot: the pilot arms with the transmitter and hands over control with the mode "
        "MSP OVERRIDE. bridge: the bridge is the only receiver and arms.",
        choices=("pilot", "bridge"),
    )
    arm_channel: int = parameter(
        5, doc="receiver bridge: channel that arms when high.", minimum=5, maximum=16
    )
    motor_idle: float = parameter(
        0.055,
        doc="motor_idle of the flight controller as a fraction: motor output at zero throttle.",
        minimum=0.0,
        maximum=0.3,
    )
    min_check: int = parameter(
        1050, doc="min_check of the flight controller.", unit="us", minimum=1000, maximum=1400
    )
    lost: BetaflightLossParameters = dataclasses.field(default_factory=BetaflightLossParameters)
