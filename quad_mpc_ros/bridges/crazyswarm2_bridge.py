"""Crazyswarm2: its rules.

The firmware keeps the thrust locked until a setpoint of thrust 0 has come, levels after half a
second without setpoints and cuts the motors after two. It takes rates only with
``flightmode.stabModeRoll`` and ``stabModePitch`` set to 0, which is the user's to set.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.bridges import crazyswarm2_codec as codec
from quad_mpc_ros.bridges.bridge import Answer, Call, Sending, Subscription
from quad_mpc_ros.bridges.config import BridgeConfig
from quad_mpc_ros.bridges.differentiator import PoseDifferentiator
from quad_mpc_ros.bridges.link import Link
from quad_mpc_ros.bridges.own_switch import SwitchedBridge
from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.model.samples import CommandSample, OdometrySample

_LOCKS_AFTER_NS = 2_000_000_000
# The radio may lose one; on the ground they cost nothing.
_UNLOCKING_SETPOINTS = 3
_STATUS_TIMEOUT = 10.0  # s: the server logs it once a second or less
_ARM = "crazyflie_interfaces/srv/Arm"


@dataclass(frozen=True, kw_only=True)
class Crazyswarm2Config(BridgeConfig):
    """Parameters of the Crazyswarm2 bridge."""

    owner = "crazyswarm2_bridge"

    crazyflie: str = parameter("/cf231", doc="Name of the Crazyflie, as a namespace.")
    state: str = parameter(
        "odom",
        doc="Where the state comes from: odom, without body rates, or pose, without any.",
        choices=("odom", "pose"),
    )


class Crazyswarm2Bridge(SwitchedBridge):
    """Legacy setpoints with rates in degrees and thrust in PWM out, odom or pose in."""

    name = "crazyswarm2_bridge"
    speaks = "Crazyswarm2: cmd_vel_legacy (Twist)"
    packages = ("crazyflie_interfaces",)
    how_to_get = (
        "install Crazyswarm2 (https://imrclab.github.io/crazyswarm2/installation.html), or build "
        "crazyflie_interfaces of https://github.com/IMRCLab/crazyswarm2 with colcon"
    )
    Config = Crazyswarm2Config

    def __init__(self, config: Crazyswarm2Config, new: NewMessage) -> None:
        super().__init__(config, new)
        self._setpoint = self._topic("cmd_vel_legacy", "geometry_msgs/msg/Twist", reliable=True)
        self._differentiator = PoseDifferentiator(velocity_too=config.state == "pose")
        self._status: Link[Any] = Link(timeout=_STATUS_TIMEOUT)
        self._unlocking = 0
        self._sent_ns: int | None = None

    @property
    def subscriptions(self) -> Sequence[Subscription]:
        """State, status with the battery."""
        pose = self._config.state == "pose"
        kind = "geometry_msgs/msg/PoseStamped" if pose else "nav_msgs/msg/Odometry"
        state = self._topic(self._config.state, kind)
        status = self._topic("status", "crazyflie_interfaces/msg/Status")
        return (
            Subscription(topic=state, receive=self._on_state),
            Subscription(topic=status, receive=self._on_status),
        )

    @property
    def publications(self) -> Sequence[Topic]:
        """The setpoint."""
        return (self._setpoint,)

    @property
    def services(self) -> Sequence[tuple[str, str]]:
        """Arming."""
        return ((f"{self._config.crazyflie}/arm", _ARM),)

    def arm(self, wanted: bool, *, now_ns: int) -> Answer:
        """Ask the server to arm or disarm, which vehicles with brushless motors need."""
        request = self._new(_ARM)
        request.arm = wanted
        call = Call(service=f"{self._config.crazyflie}/arm", type_name=_ARM, request=request)
        what = "arming" if wanted else "disarming"
        return Answer(accepted=True, text=f"asked for {what}", calls=[call])

    def _reason_for_silence(self, now_ns: int) -> str | None:
        status = self._status.value(now_ns=now_ns)
        if status is not None and status.supervisor_info & codec.SUPERVISOR_IS_TUMBLED:
            return "the Crazyflie lies upside down"
        if status is not None and status.supervisor_info & codec.SUPERVISOR_IS_LOCKED:
            return "the Crazyflie is locked: restart it"
        return super()._reason_for_silence(now_ns)

    def _acts(self, now_ns: int) -> bool:
        """Return whether it is unlocked and, where its status comes, armed."""
        status = self._status.value(now_ns=now_ns)
        armed = status is None or bool(status.supervisor_info & codec.SUPERVISOR_IS_ARMED)
        locked = self._sent_ns is None or now_ns - self._sent_ns >= _LOCKS_AFTER_NS
        return armed and not locked and self._unlocking == 0

    def _messages(self, command: CommandSample, now_ns: int) -> list[Sending]:
        if self._sent_ns is None or now_ns - self._sent_ns >= _LOCKS_AFTER_NS:
            self._unlocking = _UNLOCKING_SETPOINTS
        self._sent_ns = now_ns
        message = self._new(self._setpoint.type_name)
        if self._unlocking > 0:
            self._unlocking -= 1
            codec.fill_unlock(message)
        else:
            throttle = self.thrust.stack_throttle(command.throttle)
            codec.fill_setpoint(message, command, throttle=throttle)
        return [Sending(topic=self._setpoint, message=message)]

    def _on_state(self, message: Any, now_ns: int) -> OdometrySample | None:
        pose = self._config.state == "pose"
        try:
            odometry = (
                codec.odometry_from_pose(message) if pose else codec.odometry_from_odom(message)
            )
            completed = self._differentiator.completed(odometry)
        except ValueError as error:
            self._refuse(f"{self._config.state}: {error}")
            return None
        return None if completed is None else self._passed_on(completed, now_ns=now_ns)

    def _on_status(self, message: Any, now_ns: int) -> None:
        self._status.receive(message, now_ns=now_ns)
        self.thrust.receive_voltage(float(message.battery_voltage), now_ns=now_ns)

    def _topic(self, path: str, type_name: str, *, reliable: bool = False) -> Topic:
        """Return a topic: what is heard unreliably matches whatever the server publishes."""
        return Topic(
            name=f"{self._config.crazyflie}/{path}",
            type_name=type_name,
            reliable=reliable,
            depth=1,
        )


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros crazyswarm2_bridge``."""
    from quad_mpc_ros.bridges.node import run_bridge

    sys.exit(run_bridge(Crazyswarm2Bridge, args))


if __name__ == "__main__":
    main()
