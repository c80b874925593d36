# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the MAVLink bridge."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.ros.bridges.config import EstimatorConfig
from quad_mpc_ros.ros.bridges.line import NETWORK_PREFIXES, address_of


@dataclass(frozen=True, kw_only=True)
class MavlinkConfig(EstimatorConfig):
    """Parameters of the MAVLink bridge."""

    owner = "mavlink_bridge"

    device: str = parameter(
        "udpin:127.0.0.1:14540",
        doc="Connection to the autopilot: a serial port like /dev/ttyACM0, udpin:HOST:PORT to "
        "listen, udpout:HOST:PORT or tcp:HOST:PORT to connect.",
    )
    baud: int = parameter(
        921600, doc="Baud rate of a serial port.", unit="bit/s", minimum=9600, maximum=4000000
    )
    target_system: int = parameter(
        0,
        doc="MAV_SYS_ID (SYSID_THISMAV) of the vehicle; 0 is the first vehicle that sends.",
        minimum=0,
        maximum=255,
    )
    state_rate: float = parameter(
        100.0,
        doc="Requested rate of the vehicle's state.",
        unit="Hz",
        minimum=10.0,
        maximum=400.0,
    )
    odometry_topic: str = parameter(
        "",
        doc="Topic of an estimator's nav_msgs/Odometry, in ENU, which replaces the autopilot's "
        "state; empty uses the autopilot's state.",
    )
    guided_mode: str = parameter(
        "GUIDED",
        doc="ArduPilot: the mode for setpoints; GUIDED_NOGPS needs no position estimate.",
        choices=("GUIDED", "GUIDED_NOGPS"),
    )
    release_mode: str = parameter(
        "LOITER",
        doc="ArduPilot: the mode after ~/engage false. LOITER and ALT_HOLD need a pilot's sticks.",
        choices=("LOITER", "BRAKE", "ALT_HOLD", "LAND", "RTL"),
    )
    land_mode_after: float = parameter(
        1.0,
        doc="ArduPilot: time on the ground after which the bridge requests LAND, because guided "
        "modes neither detect a landing nor disarm; 0 disables the request.",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    )

    def check(self) -> None:
        """Reject an invalid address."""
        super().check()
        if self.device.startswith(NETWORK_PREFIXES) and address_of(self.device) is None:
            raise ConfigurationError(
                f"{self.owner}.device", self.device, "like udpin:127.0.0.1:14540"
            )
