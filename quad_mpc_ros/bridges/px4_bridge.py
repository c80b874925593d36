"""PX4 over uXRCE-DDS: its rules.

The heartbeat ``offboard_control_mode`` must run for a second before PX4 arms or switches to
offboard. PX4 does not fail safe when setpoints stop while the heartbeat runs on, so a heartbeat
is sent only together with a fresh command.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.bridges import px4_codec
from quad_mpc_ros.bridges.bridge import Answer, Bridge, Sending, Subscription
from quad_mpc_ros.bridges.config import BridgeConfig
from quad_mpc_ros.bridges.link import Link
from quad_mpc_ros.bridges.stream import SetpointStream
from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.model.samples import CommandSample, OdometrySample

_STATUS_TIMEOUT = 1.5  # s: PX4 sends it twice a second, and at every change
_FROM_MESSAGE = -1
_ACCEPTED, _IN_PROGRESS = 0, 5


@dataclass(frozen=True, kw_only=True)
class Px4Config(BridgeConfig):
    """Parameters of the PX4 bridge."""

    owner = "px4_bridge"

    fmu: str = parameter(
        "/fmu", doc="Prefix of PX4's topics; /px4_1/fmu for the client key px4_1."
    )
    target_system: int = parameter(
        1, doc="MAV_SYS_ID of the vehicle that is armed and switched.", minimum=1, maximum=255
    )
    odometry_version: int = parameter(
        _FROM_MESSAGE,
        doc="Version N of VehicleOdometry on the vehicle, whose topic then ends in _vN; 0 is no "
        "suffix and -1 that of the installed px4_msgs.",
        minimum=_FROM_MESSAGE,
    )
    status_version: int = parameter(
        _FROM_MESSAGE, doc="The same of VehicleStatus.", minimum=_FROM_MESSAGE
    )
    rates_version: int = parameter(
        _FROM_MESSAGE, doc="The same of VehicleRatesSetpoint.", minimum=_FROM_MESSAGE
    )
    command_version: int = parameter(
        _FROM_MESSAGE, doc="The same of VehicleCommand.", minimum=_FROM_MESSAGE
    )
    ack_version: int = parameter(
        _FROM_MESSAGE, doc="The same of VehicleCommandAck.", minimum=_FROM_MESSAGE
    )
    battery_version: int = parameter(
        _FROM_MESSAGE, doc="The same of BatteryStatus.", minimum=_FROM_MESSAGE
    )


class Px4Bridge(Bridge):
    """Heartbeat and rate setpoints out, vehicle odometry and status in."""

    name = "px4_bridge"
    speaks = "PX4 over uXRCE-DDS: VehicleRatesSetpoint"
    packages = ("px4_msgs",)
    how_to_get = (
        "clone https://github.com/PX4/px4_msgs on the branch of the vehicle's PX4 release into "
        "the workspace and build it with colcon"
    )
    Config = Px4Config

    def __init__(self, config: Px4Config, new: NewMessage) -> None:
        super().__init__(config, new)
        self._target = config.target_system
        self._odometry = self._topic("out/vehicle_odometry", "VehicleOdometry", "odometry")
        self._status_topic = self._topic("out/vehicle_status", "VehicleStatus", "status")
        self._ack = self._topic("out/vehicle_command_ack", "VehicleCommandAck", "ack")
        self._battery = self._topic("out/battery_status", "BatteryStatus", "battery")
        self._heartbeat = self._topic("in/offboard_control_mode", "OffboardControlMode", None)
        self._rates = self._topic("in/vehicle_rates_setpoint", "VehicleRatesSetpoint", "rates")
        self._command = self._topic("in/vehicle_command", "VehicleCommand", "command")
        self._status: Link[Any] = Link(timeout=_STATUS_TIMEOUT)
        self._stream = SetpointStream()
        self._resets: tuple[int, int] | None = None

    @property
    def subscriptions(self) -> Sequence[Subscription]:
        """Odometry, status, answers to commands, battery."""
        found = [
            Subscription(topic=self._odometry, receive=self._on_odometry),
            Subscription(topic=self._status_topic, receive=self._on_status),
            Subscription(topic=self._ack, receive=self._on_ack),
        ]
        if self._config.thrust_map.battery_voltage > 0.0:
            found.append(Subscription(topic=self._battery, receive=self._on_battery))
        return found

    @property
    def publications(self) -> Sequence[Topic]:
        """Heartbeat, rate setpoint, vehicle command."""
        return self._heartbeat, self._rates, self._command

    def arm(self, wanted: bool, *, now_ns: int) -> Answer:
        """Arm once the heartbeat has run long enough; disarm at any time."""
        if wanted and (refusal := self._not_ready(now_ns)):
            return Answer(accepted=False, text=refusal)
        message = self._new(self._command.type_name)
        px4_codec.fill_arming(message, wanted=wanted, target_system=self._target)
        return self._asked("arming" if wanted else "disarming", message)

    def engage(self, wanted: bool, *, now_ns: int) -> Answer:
        """Switch to offboard mode, or from it to hold."""
        if wanted and (refusal := self._not_ready(now_ns)):
            return Answer(accepted=False, text=refusal)
        message = self._new(self._command.type_name)
        if wanted:
            px4_codec.fill_offboard_mode(message, target_system=self._target)
        else:
            px4_codec.fill_hold_mode(message, target_system=self._target)
        return self._asked("offboard mode" if wanted else "hold mode", message)

    def _reason_for_silence(self, now_ns: int) -> str | None:
        if self._status.value(now_ns=now_ns) is None:
            return f"no vehicle_status within {_STATUS_TIMEOUT:g} s on {self._status_topic.name}"
        return None

    def _acts(self, now_ns: int) -> bool:
        status = self._status.value(now_ns=now_ns)
        return (
            status is not None
            and status.nav_state == px4_codec.NAVIGATION_STATE_OFFBOARD
            and status.arming_state == px4_codec.ARMING_STATE_ARMED
        )

    def _messages(self, command: CommandSample, now_ns: int) -> list[Sending]:
        heartbeat = self._new(self._heartbeat.type_name)
        px4_codec.fill_offboard_control_mode(heartbeat)
        self._stream.sent(now_ns=now_ns)
        sendings = [Sending(topic=self._heartbeat, message=heartbeat)]
        status = self._status.value(now_ns=now_ns)
        if status is not None and status.nav_state == px4_codec.NAVIGATION_STATE_OFFBOARD:
            rates = self._new(self._rates.type_name)
            px4_codec.fill_vehicle_rates_setpoint(
                rates, command, throttle=self.thrust.stack_throttle(command.throttle)
            )
            sendings.append(Sending(topic=self._rates, message=rates))
        else:
            self.silence = "heartbeat only: the vehicle is not in offboard mode"
        return sendings

    def _on_odometry(self, message: Any, now_ns: int) -> OdometrySample | None:
        try:
            odometry = px4_codec.odometry_from_vehicle_odometry(message)
        except ValueError as error:
            self._refuse(f"vehicle_odometry: {error}")
            return None
        resets = (int(message.reset_counter), int(message.pose_frame))
        cause = None
        if self._resets is not None and resets != self._resets:
            cause = (
                f"reset_counter {self._resets[0]} to {resets[0]}, "
                f"pose_frame {self._resets[1]} to {resets[1]}"
            )
        self._resets = resets
        return self._passed_on(odometry, now_ns=now_ns, cause=cause)

    def _on_status(self, message: Any, now_ns: int) -> None:
        self._status.receive(message, now_ns=now_ns)

    def _on_ack(self, message: Any, now_ns: int) -> None:
        if message.result not in (_ACCEPTED, _IN_PROGRESS):
            self._warnings.append(
                f"PX4 answers command {message.command} with result {message.result}"
            )

    def _on_battery(self, message: Any, now_ns: int) -> None:
        self.thrust.receive_voltage(float(message.voltage_v), now_ns=now_ns)

    def _not_ready(self, now_ns: int) -> str | None:
        refusal = self._stream.refusal(now_ns=now_ns)
        return f"{refusal} ({self.silence})" if refusal and self.silence else refusal

    def _asked(self, what: str, message: Any) -> Answer:
        sending = Sending(topic=self._command, message=message)
        return Answer(accepted=True, text=f"asked for {what}", sendings=[sending])

    def _topic(self, path: str, kind: str, version_parameter: str | None) -> Topic:
        type_name = f"px4_msgs/msg/{kind}"
        version = 0
        if version_parameter is not None:
            version = getattr(self._config, f"{version_parameter}_version")
        if version == _FROM_MESSAGE:
            version = int(getattr(type(self._new(type_name)), "MESSAGE_VERSION", 0))
        suffix = f"_v{version}" if version > 0 else ""
        return Topic(
            name=f"{self._config.fmu}/{path}{suffix}",
            type_name=type_name,
            reliable=False,
            # PX4 listens without history, but some agents ask for it.
            latched=path.startswith("in/"),
        )


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros px4_bridge``."""
    from quad_mpc_ros.bridges.node import run_bridge

    sys.exit(run_bridge(Px4Bridge, args))


if __name__ == "__main__":
    main()
