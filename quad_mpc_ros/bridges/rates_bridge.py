"""Everything else that takes body rates and thrust in a ``TwistStamped``: units by parameter."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.bridges import rates_codec
from quad_mpc_ros.bridges.bridge import Answer, Sending, Subscription
from quad_mpc_ros.bridges.config import BridgeConfig
from quad_mpc_ros.bridges.own_switch import SwitchedBridge
from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.state import with_body_twist


@dataclass(frozen=True, kw_only=True)
class RatesConfig(BridgeConfig):
    """Parameters of the bridge to everything else."""

    owner = "rates_bridge"

    thrust_unit: str = parameter(
        "normalised",
        doc="Unit of the thrust in twist.linear.z: newton, mps2 (thrust over mass), or "
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
    setpoint_topic: str = parameter("rates_setpoint", doc="Topic of the TwistStamped.")
    setpoint_frame_id: str = parameter("base_link", doc="Frame that its header names.")
    odometry_topic: str = parameter(
        "stack_odom", doc="Topic of the stack's nav_msgs/Odometry, in ENU."
    )
    twist_frame: str = parameter(
        "child", doc="Frame of its twist: child (body) or world.", choices=("child", "world")
    )
    battery_topic: str = parameter(
        "battery", doc="Topic of a sensor_msgs/BatteryState, with thrust_map.battery_voltage."
    )


class RatesBridge(SwitchedBridge):
    """A twist in the stack's units out, odometry in."""

    name = "rates_bridge"
    speaks = "anything that takes body rates and thrust: TwistStamped"
    packages = ("geometry_msgs",)
    how_to_get = "sudo apt install ros-jazzy-common-interfaces"
    Config = RatesConfig

    def __init__(self, config: RatesConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        self._setpoint = Topic(
            name=config.setpoint_topic, type_name="geometry_msgs/msg/TwistStamped", reliable=True
        )

    @property
    def subscriptions(self) -> Sequence[Subscription]:
        """Odometry, battery."""
        odometry = _topic(self._config.odometry_topic, "nav_msgs/msg/Odometry")
        battery = _topic(self._config.battery_topic, "sensor_msgs/msg/BatteryState")
        found = [Subscription(topic=odometry, receive=self._on_odometry)]
        if self._config.thrust_map.battery_voltage > 0.0:
            found.append(Subscription(topic=battery, receive=self._on_battery))
        return found

    @property
    def publications(self) -> Sequence[Topic]:
        """The setpoint."""
        return (self._setpoint,)

    def arm(self, wanted: bool, *, now_ns: int) -> Answer:
        """Refuse: a topic of rates knows no arming."""
        return Answer(accepted=False, text="arm the vehicle by the means of its own stack")

    def _messages(self, command: CommandSample, now_ns: int) -> list[Sending]:
        message = self._new(self._setpoint.type_name)
        rates_codec.fill_rates(
            message,
            command,
            thrust=self._thrust(command.throttle),
            body_frame=self._config.body_frame,
            angle_unit=self._config.angle_unit,
            frame_id=self._config.setpoint_frame_id,
            now_ns=now_ns,
        )
        return [Sending(topic=self._setpoint, message=message)]

    def _thrust(self, throttle: float) -> float:
        match self._config.thrust_unit:
            case "newton":
                return self.thrust.thrust_newton(throttle)
            case "mps2":
                return self.thrust.specific_thrust(throttle)
            case _:
                return self.thrust.stack_throttle(throttle)

    def _on_odometry(self, message: Any, now_ns: int) -> OdometrySample | None:
        odometry = conversions.odometry_from_message(message)
        if self._config.twist_frame == "world":
            try:
                odometry = with_body_twist(odometry)
            except ValueError as error:
                self._refuse(f"{self._config.odometry_topic}: {error}")
                return None
        return self._passed_on(odometry, now_ns=now_ns)

    def _on_battery(self, message: Any, now_ns: int) -> None:
        self.thrust.receive_voltage(float(message.voltage), now_ns=now_ns)


def _topic(name: str, type_name: str) -> Topic:
    return Topic(name=name, type_name=type_name, reliable=False)


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros rates_bridge``."""
    from quad_mpc_ros.bridges.node import run_bridge

    sys.exit(run_bridge(RatesBridge, args))


if __name__ == "__main__":
    main()
