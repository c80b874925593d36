# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bridge to stacks with a ``TwistStamped`` of body rates and thrust in configured units."""

from __future__ import annotations

import math
from dataclasses import dataclass

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.bridges.bridge import OutgoingMessage, SwitchedBridge
from quad_mpc_ros.ros.bridges.config import EstimatorConfig
from quad_mpc_ros.ros.bridges.frames import flu_from_frd

_SETPOINT = Topic(name="rates_setpoint", type_name="geometry_msgs/msg/TwistStamped", reliable=True)
_BATTERY = Topic(name="battery", type_name="sensor_msgs/msg/BatteryState")


@dataclass(frozen=True, kw_only=True)
class RatesConfig(EstimatorConfig):
    """Parameters of the bridge to other stacks."""

    owner = "rates_bridge"

    thrust_unit: str = parameter(
        "normalised",
        doc="Unit of the thrust in twist.linear.z: newton, mps2 (specific thrust), or "
        "normalised, a throttle in [0, 1].",
        choices=("newton", "mps2", "normalised"),
    )
    body_frame: str = parameter(
        "flu",
        doc="Axes of the body: flu, thrust positive upwards, or frd, thrust negative upwards.",
        choices=("flu", "frd"),
    )
    angle_unit: str = parameter(
        "rad", doc="Unit of the body rates, per second.", choices=("rad", "deg")
    )
    setpoint_frame_id: str = parameter("base_link", doc="Frame in the header of the setpoints.")


class RatesBridge(SwitchedBridge):
    """Bridge with a twist in the stack's units out; odometry in."""

    name = "rates_bridge"
    packages = ("geometry_msgs",)
    how_to_get = "sudo apt install ros-jazzy-common-interfaces"
    Config = RatesConfig

    def __init__(self, config: RatesConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        self.publications = (_SETPOINT,)
        battery = self._battery_subscription(_BATTERY)
        self.subscriptions = [self._odometry_subscription(config.odometry_topic), *battery]

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        """Return the rates in ``twist.angular`` and the thrust along body z in ``linear.z``."""
        config, setpoint = self._config, self._message(_SETPOINT)
        frd = config.body_frame == "frd"
        rates = flu_from_frd(command.w_WB_B) if frd else command.w_WB_B
        scale = math.degrees(1.0) if config.angle_unit == "deg" else 1.0
        conversions.fill_header(setpoint.message.header, now_ns, config.setpoint_frame_id)
        conversions.fill_vector(setpoint.message.twist.angular, (scale * rates).tolist())
        thrust = self._thrust(command.throttle)
        setpoint.message.twist.linear.z = -thrust if frd else thrust
        return [setpoint]

    def _thrust(self, throttle: float) -> float:
        match self._config.thrust_unit:
            case "newton":
                return self.thrust.thrust_newton(throttle)
            case "mps2":
                return self.thrust.specific_thrust(throttle)
            case _:
                return self.thrust.stack_throttle(throttle)
