"""Bridge to stacks with a ``TwistStamped`` of body rates and thrust in configured units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

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


def fill_rates(
    message: Any,
    command: CommandSample,
    *,
    thrust: float,
    body_frame: str,
    angle_unit: str,
    frame_id: str,
    now_ns: int,
) -> None:
    """Write the rates into ``twist.angular`` and the thrust along body z into ``twist.linear.z``.

    ``thrust`` is the upward thrust in the stack's unit: positive along z in ``flu``, negative in
    ``frd``. ``angle_unit`` is ``rad`` or ``deg``.
    """
    frd = body_frame == "frd"
    rates = flu_from_frd(command.w_WB_B) if frd else command.w_WB_B
    scale = math.degrees(1.0) if angle_unit == "deg" else 1.0
    conversions.fill_header(message.header, now_ns, frame_id)
    conversions.fill_vector(message.twist.angular, (scale * rates).tolist())
    message.twist.linear.z = -thrust if frd else thrust


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
        self.subscriptions = [
            self._odometry_subscription(config.odometry_topic, twist_frame=config.twist_frame),
            *self._battery_subscription(_BATTERY),
        ]

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        message = self._new(_SETPOINT.type_name)
        fill_rates(
            message,
            command,
            thrust=self._thrust(command.throttle),
            body_frame=self._config.body_frame,
            angle_unit=self._config.angle_unit,
            frame_id=self._config.setpoint_frame_id,
            now_ns=now_ns,
        )
        return [OutgoingMessage(topic=_SETPOINT, message=message)]

    def _thrust(self, throttle: float) -> float:
        match self._config.thrust_unit:
            case "newton":
                return self.thrust.thrust_newton(throttle)
            case "mps2":
                return self.thrust.specific_thrust(throttle)
            case _:
                return self.thrust.stack_throttle(throttle)
