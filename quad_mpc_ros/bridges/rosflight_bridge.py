"""ROSflight: its rules.

The safety pilot arms and hands over by switches of the RC transmitter; no topic can. ROSflight
drops back to RC when no command has come for 100 ms, so commands are sent whenever they are
fresh, and the firmware decides whether to act on them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.bridges import rosflight_codec
from quad_mpc_ros.bridges.bridge import Answer, Bridge, Sending, Subscription
from quad_mpc_ros.bridges.config import BridgeConfig
from quad_mpc_ros.bridges.link import Link
from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.model.samples import CommandSample, OdometrySample

_STATUS_TIMEOUT = 2.0  # s
_STATES = {
    "estimator": ("roscopter_msgs/msg/State", rosflight_codec.odometry_from_state),
    "truth": ("rosflight_msgs/msg/SimState", rosflight_codec.odometry_from_sim_state),
}


@dataclass(frozen=True, kw_only=True)
class RosflightConfig(BridgeConfig):
    """Parameters of the ROSflight bridge."""

    owner = "rosflight_bridge"

    state: str = parameter(
        "estimator",
        doc="Where the state comes from: ROScopter's estimator, or the simulator's truth.",
        choices=tuple(_STATES),
    )
    estimator_topic: str = parameter("/estimated_state", doc="Topic of the estimator.")
    truth_topic: str = parameter("/sim/truth_state", doc="Topic of the simulator's truth.")
    command_topic: str = parameter("/command", doc="Topic that rosflight_io listens to.")
    status_topic: str = parameter("/status", doc="Topic of rosflight_io's status.")
    battery_topic: str = parameter("/battery", doc="Topic of rosflight_io's battery status.")


class RosflightBridge(Bridge):
    """Offboard commands out, estimated state and status in."""

    name = "rosflight_bridge"
    speaks = "ROSflight 2: rosflight_msgs/Command"
    packages = ("rosflight_msgs", "roscopter_msgs")
    how_to_get = (
        "clone https://github.com/rosflight/rosflight_ros_pkgs and "
        "https://github.com/rosflight/roscopter into the workspace and build them with colcon"
    )
    Config = RosflightConfig

    def __init__(self, config: RosflightConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        type_name, self._odometry_of = _STATES[config.state]
        truth = config.state == "truth"
        self._state = _topic(config.truth_topic if truth else config.estimator_topic, type_name)
        self._command = Topic(
            name=config.command_topic, type_name="rosflight_msgs/msg/Command", reliable=True
        )
        self._status: Link[Any] = Link(timeout=_STATUS_TIMEOUT)

    @property
    def subscriptions(self) -> Sequence[Subscription]:
        """State, status, battery."""
        status = _topic(self._config.status_topic, "rosflight_msgs/msg/Status")
        battery = _topic(self._config.battery_topic, "rosflight_msgs/msg/BatteryStatus")
        found = [
            Subscription(topic=self._state, receive=self._on_state),
            Subscription(topic=status, receive=self._on_status),
        ]
        if self._config.thrust_map.battery_voltage > 0.0:
            found.append(Subscription(topic=battery, receive=self._on_battery))
        return found

    @property
    def publications(self) -> Sequence[Topic]:
        """The offboard command."""
        return (self._command,)

    def arm(self, wanted: bool, *, now_ns: int) -> Answer:
        """Refuse: only the safety pilot arms."""
        return Answer(accepted=False, text="ROSflight is armed by the RC transmitter only")

    def engage(self, wanted: bool, *, now_ns: int) -> Answer:
        """Refuse: only the safety pilot hands over."""
        return Answer(
            accepted=False,
            text="ROSflight is handed over by the RC override switches (RC_ATT_OVRD_CHN, "
            "RC_THR_OVRD_CHN) only",
        )

    def _reason_for_silence(self, now_ns: int) -> str | None:
        status = self._status.value(now_ns=now_ns)
        if status is None:
            return f"no status within {_STATUS_TIMEOUT:g} s on {self._config.status_topic}"
        return "ROSflight is in failsafe" if status.failsafe else None

    def _acts(self, now_ns: int) -> bool:
        status = self._status.value(now_ns=now_ns)
        return status is not None and bool(status.armed) and bool(status.offboard)

    def _messages(self, command: CommandSample, now_ns: int) -> list[Sending]:
        message = self._new(self._command.type_name)
        rosflight_codec.fill_command(
            message,
            command,
            throttle=self.thrust.stack_throttle(command.throttle),
            now_ns=now_ns,
        )
        return [Sending(topic=self._command, message=message)]

    def _on_state(self, message: Any, now_ns: int) -> OdometrySample | None:
        try:
            odometry = self._odometry_of(message)
        except ValueError as error:
            self._refuse(f"{self._state.name}: {error}")
            return None
        return self._passed_on(odometry, now_ns=now_ns)

    def _on_status(self, message: Any, now_ns: int) -> None:
        self._status.receive(message, now_ns=now_ns)

    def _on_battery(self, message: Any, now_ns: int) -> None:
        self.thrust.receive_voltage(float(message.voltage), now_ns=now_ns)


def _topic(name: str, type_name: str) -> Topic:
    return Topic(name=name, type_name=type_name, reliable=False)


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros rosflight_bridge``."""
    from quad_mpc_ros.bridges.node import run_bridge

    sys.exit(run_bridge(RosflightBridge, args))


if __name__ == "__main__":
    main()
