# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Aerostack2 (as2_msgs, geometry_msgs), ENU and FLU.

The platform must be in offboard mode and in the control mode for body rates. Commands are a twist
and a thrust on two topics; the platform uses the newest message of each.

Fields and constants as in https://github.com/aerostack2/aerostack2 (as2_msgs).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.control.model.state import with_body_twist
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.conversions import NewMessage, nanoseconds
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    Outgoing,
    OutgoingMessage,
    Response,
    Subscription,
)
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.handover import LatestStatus, Stack

# Named ACRO until August 2026, with the same number.
CONTROL_MODE_BODY_RATES = 6
YAW_MODE_YAW_SPEED = 2
KILL_SWITCH = -1  # as2_msgs/AlertEvent
BODY_FRAME = "base_link"
_WORLD_FRAMES = ("earth", "map", "odom")

_INFO_TIMEOUT = 1.0  # s: the platform publishes it ten times a second
_PAIR_TOLERANCE_NS = 5_000_000
_SET_BOOL = "std_srvs/srv/SetBool"


def odometry_from_self_localization(pose: Any, twist: Any) -> OdometrySample:
    """Return the odometry in a ``PoseStamped`` and a ``TwistStamped`` of equal stamps.

    Frames may be prefixed with the vehicle's namespace. Raises ``ValueError`` for a twist in
    neither the body nor a world frame.
    """
    odometry = conversions.odometry_from_pose_and_twist(pose, twist, child_frame_id=BODY_FRAME)
    frame = str(twist.header.frame_id).rsplit("/", 1)[-1]
    if frame == BODY_FRAME:
        return odometry
    if frame not in _WORLD_FRAMES:
        raise ValueError(
            f"the twist is in frame {twist.header.frame_id!r}, expected {BODY_FRAME} or one of "
            f"{', '.join(_WORLD_FRAMES)}"
        )
    return with_body_twist(odometry)


def fill_thrust(
    message: Any, *, thrust_newton: float, throttle: float, frame_id: str, now_ns: int
) -> None:
    """Write a thrust [N] into an ``as2_msgs/Thrust``, and the throttle, if present."""
    conversions.fill_header(message.header, now_ns, frame_id)
    message.thrust = thrust_newton
    if hasattr(message, "thrust_normalized"):
        message.thrust_normalized = throttle


def fill_body_rates(message: Any, command: CommandSample, *, frame_id: str, now_ns: int) -> None:
    """Write body rates [rad/s, FLU] into a ``TwistStamped``."""
    conversions.fill_header(message.header, now_ns, frame_id)
    conversions.fill_vector(message.twist.angular, command.w_WB_B.tolist())


@dataclass(frozen=True, kw_only=True)
class Aerostack2Config(BridgeConfig):
    """Parameters of the Aerostack2 bridge."""

    owner = "aerostack2_bridge"

    drone: str = parameter("/drone0", doc="Namespace of the drone.")


class Aerostack2Bridge(Bridge):
    """Thrust in newton and body rates out, self-localization and platform info in."""

    name = "aerostack2_bridge"
    packages = ("as2_msgs",)
    how_to_get = (
        "install Aerostack2 (https://aerostack2.github.io), or build as2_msgs of "
        "https://github.com/aerostack2/aerostack2 with colcon"
    )
    Config = Aerostack2Config

    def __init__(self, config: Aerostack2Config, new: NewMessage) -> None:
        super().__init__(config, new, namespace=config.drone)
        self._frame_id = f"{config.drone.strip('/')}/{BODY_FRAME}".lstrip("/")
        self._thrust = self._topic("actuator_command/thrust", "as2_msgs/msg/Thrust")
        self._rates = self._topic("actuator_command/twist", "geometry_msgs/msg/TwistStamped")
        self._alert = self._topic("alert_event", "as2_msgs/msg/AlertEvent", reliable=True)
        self.publications = self._thrust, self._rates, self._alert
        pose = self._topic("self_localization/pose", "geometry_msgs/msg/PoseStamped")
        twist = self._topic("self_localization/twist", "geometry_msgs/msg/TwistStamped")
        info = self._topic("platform/info", "as2_msgs/msg/PlatformInfo", reliable=True, depth=10)
        battery = self._topic("sensor_measurements/battery", "sensor_msgs/msg/BatteryState")
        self._info_name = info.name
        self._info = LatestStatus(timeout=_INFO_TIMEOUT)
        self._parts: dict[str, Any] = {}
        self.subscriptions = [
            Subscription(topic=pose, receive=functools.partial(self._on_part, "pose")),
            Subscription(topic=twist, receive=functools.partial(self._on_part, "twist")),
            Subscription(topic=info, receive=self._info.receive),
            *self._battery_subscription(battery),
        ]
        self._arm_service = self._service("set_arming_state", _SET_BOOL)
        self._offboard = self._service("set_offboard_mode", _SET_BOOL)
        self._mode = self._service("set_platform_control_mode", "as2_msgs/srv/SetControlMode")
        self.services = self._arm_service, self._offboard, self._mode

    def _stack(self, now_ns: int) -> Stack:
        info = self._info.value(now_ns=now_ns)
        if info is None:
            return Stack(fault=f"no platform info within {_INFO_TIMEOUT:g} s on {self._info_name}")
        if not info.connected:
            return Stack(fault="the platform is not connected")
        mode = info.current_control_mode.control_mode
        return Stack(
            takes_setpoints=bool(info.offboard) and mode == CONTROL_MODE_BODY_RATES,
            armed=bool(info.armed),
        )

    def _arm(self, wanted: bool) -> Response:
        what = "arming" if wanted else "disarming"
        receive = functools.partial(self._on_arming, what)
        call = self._call(self._arm_service, receive=receive, data=wanted)
        if wanted or self._ground.landed:
            return Response(accepted=True, text=f"asked for {what}", calls=[call])
        # In the air a platform may refuse to disarm, but not its kill switch.
        why = "disarming requested in the air"
        kill = self._message(self._alert, alert=KILL_SWITCH, description=why)
        text = "requested the kill switch and disarming"
        return Response(accepted=True, text=text, messages=[kill], calls=[call])

    def _on_arming(self, what: str, response: Any) -> None:
        if not response.success:
            self._refuse_arming(f"the platform refuses {what}")

    def _switch(self) -> list[Outgoing]:
        mode = self._call(self._mode)
        mode.request.control_mode.control_mode = CONTROL_MODE_BODY_RATES
        mode.request.control_mode.yaw_mode = YAW_MODE_YAW_SPEED
        return [mode, self._call(self._offboard, data=True)]

    def _switch_back(self, now_ns: int) -> Response:
        offboard = self._call(self._offboard, data=False)
        return Response(accepted=True, text="requested leaving offboard mode", calls=[offboard])

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        thrust, rates = self._message(self._thrust), self._message(self._rates)
        fill_thrust(
            thrust.message,
            thrust_newton=self.thrust.thrust_newton(command.throttle),
            throttle=self.thrust.stack_throttle(command.throttle),
            frame_id=self._frame_id,
            now_ns=now_ns,
        )
        fill_body_rates(rates.message, command, frame_id=self._frame_id, now_ns=now_ns)
        return [thrust, rates]

    def _on_part(self, part: str, message: Any, now_ns: int) -> OdometrySample | None:
        """Return the odometry once pose and twist with equal stamps have arrived."""
        self._parts[part] = message
        if len(self._parts) < 2:
            return None
        pose, twist = self._parts["pose"], self._parts["twist"]
        apart_ns = nanoseconds(pose.header.stamp) - nanoseconds(twist.header.stamp)
        if abs(apart_ns) > _PAIR_TOLERANCE_NS:
            return None
        self._parts.clear()
        odometry = self._converted(
            "self_localization", lambda: odometry_from_self_localization(pose, twist)
        )
        return self._passed_on(odometry, now_ns=now_ns)
