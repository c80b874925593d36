"""Parameters of the Betaflight bridge."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.ros.bridges.config import EstimatorConfig


@dataclass(frozen=True, kw_only=True)
class BetaflightLossParameters(Configuration):
    """What a vehicle does that the MPC has flown and does not fly any more."""

    owner = "lost"

    after: float = parameter(
        0.15, doc="Without a command for so long it is lost.", unit="s", above=0.0, maximum=0.5
    )
    thrust: float = parameter(
        0.85, doc="Thrust over weight with which it comes down, level.", minimum=0.0, maximum=1.0
    )
    duration: float = parameter(
        3.0, doc="Then the motors stop; it is disarmed.", unit="s", minimum=0.0, maximum=60.0
    )
    level_gain: float = parameter(
        4.0, doc="Body rate over the tilt that is left.", unit="1/s", minimum=0.0, maximum=20.0
    )


@dataclass(frozen=True, kw_only=True)
class BetaflightConfig(EstimatorConfig):
    """Parameters of the Betaflight bridge."""

    owner = "betaflight_bridge"

    device: str = parameter("/dev/ttyAMA0", doc="Serial port to the flight controller.")
    baud: int = parameter(115200, doc="Its speed.", unit="bit/s", minimum=9600, maximum=4000000)
    receiver: str = parameter(
        "pilot",
        doc="Receiver: pilot, a transmitter that arms and gives the sticks to the bridge by the "
        "mode MSP OVERRIDE; or bridge, which is the only receiver and arms.",
        choices=("pilot", "bridge"),
    )
    arm_channel: int = parameter(
        5, doc="receiver bridge: the channel that arms, high.", minimum=5, maximum=16
    )
    motor_idle: float = parameter(
        0.055,
        doc="motor_idle of the flight controller over 100 %: level of the motors at the least "
        "throttle.",
        minimum=0.0,
        maximum=0.3,
    )
    min_check: int = parameter(
        1050, doc="min_check of the flight controller.", unit="us", minimum=1000, maximum=1400
    )
    lost: BetaflightLossParameters = dataclasses.field(default_factory=BetaflightLossParameters)
