"""Aerostack2 (as2_msgs, geometry_msgs), ENU and FLU.

The platform must be in offboard mode and in the control mode of body rates. Its commands are a
twist and a thrust on two topics, of which it takes the newest of each.

Fields and constants after https://github.com/aerostack2/aerostack2 (as2_msgs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.bridges.autopilot import LatestStatus
from quad_mpc_ros.bridges.bridge import (
    Bridge,
    OutgoingMessage,
    Response,
    ServiceCall,
    Subscription,
)
from quad_mpc_ros.bridges.config import BridgeConfig
from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.messages.conversions import (
    NewMessage,
    fill_time,
    nanoseconds,
    odometry_from_pose_and_twist,
)
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.state import with_body_twist

# ACRO until August 2026, BODY_RATES since: the number stayed.
CONTROL_MODE_BODY_RATES = 6
YAW_MODE_YAW_SPEED = 2
BODY_FRAME = "base_link"
_WORLD_FRAMES = ("earth", "map", "odom")

_INFO_TIMEOUT = 1.0  # s: the platform publishes it ten times a second
_PAIR_TOLERANCE_NS = 5_000_000
_SET_BOOL, _SET_CONTROL_MODE = "std_srvs/srv/SetBool", "as2_msgs/srv/SetControlMode"


def odometry_from_self_localization(pose: Any, twist: Any) -> OdometrySample:
    """Return the values of a ``PoseStamped`` and the ``TwistStamped`` of the same time.

    Frames may have the vehicle's namespace in front. Raises ``ValueError`` for a twist in neither
    the body nor a world frame.
    """
    odometry = odometry_from_pose_and_twist(pose, twist, child_frame_id=BODY_FRAME)
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
    """Write a thrust [N] into an ``as2_msgs/Thrust``, and the throttle where it has a field."""
    fill_time(message.header.stamp, now_ns)
    message.header.frame_id = frame_id
    message.thrust = thrust_newton
    if hasattr(message, "thrust_normalized"):
        message.thrust_normalized = throttle


def fill_body_rates(message: Any, command: CommandSample, *, frame_id: str, now_ns: int) -> None:
    """Write body rates [rad/s, FLU] into a ``TwistStamped``."""
    fill_time(message.header.stamp, now_ns)
    message.header.frame_id = frame_id
    angular = message.twist.angular
    angular.x, angular.y, angular.z = command.w_WB_B.tolist()


def fill_control_mode(request: Any) -> None:
    """Write the mode of body rates into a request of ``SetControlMode``."""
    request.control_mode.control_mode = CONTROL_MODE_BODY_RATES
    request.control_mode.yaw_mode = YAW_MODE_YAW_SPEED


@dataclass(frozen=True, kw_only=True)
class Aerostack2Config(BridgeConfig):
    """Parameters of the Aerostack2 bridge."""

    owner = "aerostack2_bridge"

    drone: str = parameter("/drone0", doc="Namespace of the drone.")


class Aerostack2Bridge(Bridge):
    """Thrust in newton and body rates out, self-localization and platform info in."""

    name = "aerostack2_bridge"
    speaks = "Aerostack2: TwistStamped and as2_msgs/Thrust"
    packages = ("as2_msgs",)
    how_to_get = (
        "install Aerostack2 (https://aerostack2.github.io), or build as2_msgs of "
        "https://github.com/aerostack2/aerostack2 with colcon"
    )
    Config = Aerostack2Config

    def __init__(self, config: Aerostack2Config, new: NewMessage) -> None:
        super().__init__(config, new)
        self._frame_id = f"{config.drone.strip('/')}/{BODY_FRAME}".lstrip("/")
        self._thrust = self._topic("actuator_command/thrust", "as2_msgs/msg/Thrust")
        self._rates = self._topic("actuator_command/twist", "geometry_msgs/msg/TwistStamped")
        self._info_topic = Topic(
            name=f"{config.drone}/platform/info",
            type_name="as2_msgs/msg/PlatformInfo",
            reliable=True,
            depth=10,
        )
        self._info: LatestStatus[Any] = LatestStatus(timeout=_INFO_TIMEOUT)
        self._pose: Any = None
        self._twist: Any = None

    @property
    def subscriptions(self) -> Sequence[Subscription]:
        """Pose, twist, platform info, battery."""
        pose = self._topic("self_localization/pose", "geometry_msgs/msg/PoseStamped")
        twist = self._topic("self_localization/twist", "geometry_msgs/msg/TwistStamped")
        battery = self._topic("sensor_measurements/battery", "sensor_msgs/msg/BatteryState")
        return [
            Subscription(topic=pose, receive=self._on_pose),
            Subscription(topic=twist, receive=self._on_twist),
            Subscription(topic=self._info_topic, receive=self._info.receive),
            *self._battery_subscription(battery),
        ]

    @property
    def publications(self) -> Sequence[Topic]:
        """Thrust and body rates."""
        return self._thrust, self._rates

    @property
    def services(self) -> Sequence[tuple[str, str]]:
        """Arming, offboard mode, control mode."""
        return (
            (self._service("set_arming_state"), _SET_BOOL),
            (self._service("set_offboard_mode"), _SET_BOOL),
            (self._service("set_platform_control_mode"), _SET_CONTROL_MODE),
        )

    def arm(self, wanted: bool, *, now_ns: int) -> Response:
        """Ask the platform to arm or disarm."""
        what = "arming" if wanted else "disarming"
        return Response(
            accepted=True,
            text=f"asked for {what}",
            calls=[self._set_bool("set_arming_state", wanted)],
        )

    def engage(self, wanted: bool, *, now_ns: int) -> Response:
        """Ask the platform for body rates and offboard mode, or to leave offboard mode."""
        offboard = self._set_bool("set_offboard_mode", wanted)
        if not wanted:
            return Response(accepted=True, text="asked to leave offboard mode", calls=[offboard])
        request = self._new(_SET_CONTROL_MODE)
        fill_control_mode(request)
        mode = ServiceCall(
            service=self._service("set_platform_control_mode"),
            type_name=_SET_CONTROL_MODE,
            request=request,
        )
        return Response(
            accepted=True, text="asked for body rates in offboard mode", calls=[mode, offboard]
        )

    def _reason_for_silence(self, now_ns: int) -> str | None:
        info = self._info.value(now_ns=now_ns)
        if info is None:
            return f"no platform info within {_INFO_TIMEOUT:g} s on {self._info_topic.name}"
        if not info.connected:
            return "the platform is not connected"
        if not info.offboard:
            return "the platform is not in offboard mode"
        mode = info.current_control_mode.control_mode
        if mode != CONTROL_MODE_BODY_RATES:
            return f"the platform is in control mode {mode}, not 6 (body rates)"
        return None

    def _acts(self, now_ns: int) -> bool:
        info = self._info.value(now_ns=now_ns)
        return info is not None and bool(info.armed)

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        thrust, rates = self._new(self._thrust.type_name), self._new(self._rates.type_name)
        fill_thrust(
            thrust,
            thrust_newton=self.thrust.thrust_newton(command.throttle),
            throttle=self.thrust.stack_throttle(command.throttle),
            frame_id=self._frame_id,
            now_ns=now_ns,
        )
        fill_body_rates(rates, command, frame_id=self._frame_id, now_ns=now_ns)
        return [
            OutgoingMessage(topic=self._thrust, message=thrust),
            OutgoingMessage(topic=self._rates, message=rates),
        ]

    def _on_pose(self, message: Any, now_ns: int) -> OdometrySample | None:
        self._pose = message
        return self._paired(now_ns)

    def _on_twist(self, message: Any, now_ns: int) -> OdometrySample | None:
        self._twist = message
        return self._paired(now_ns)

    def _paired(self, now_ns: int) -> OdometrySample | None:
        """Return the odometry once pose and twist of the same time are both there."""
        pose, twist = self._pose, self._twist
        if pose is None or twist is None:
            return None
        apart_ns = nanoseconds(pose.header.stamp) - nanoseconds(twist.header.stamp)
        if abs(apart_ns) > _PAIR_TOLERANCE_NS:
            return None
        self._pose = self._twist = None
        try:
            odometry = odometry_from_self_localization(pose, twist)
        except ValueError as error:
            self._refuse(f"self_localization: {error}")
            return None
        return self._passed_on(odometry, now_ns=now_ns)

    def _set_bool(self, service: str, wanted: bool) -> ServiceCall:
        request = self._new(_SET_BOOL)
        request.data = wanted
        return ServiceCall(service=self._service(service), type_name=_SET_BOOL, request=request)

    def _service(self, name: str) -> str:
        return f"{self._config.drone}/{name}"

    def _topic(self, path: str, type_name: str) -> Topic:
        return Topic(name=f"{self._config.drone}/{path}", type_name=type_name, reliable=False)
