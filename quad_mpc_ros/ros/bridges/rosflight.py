"""ROSflight 2 (rosflight_msgs, roscopter_msgs), NED and FRD.

The safety pilot arms and hands over by switches of the RC transmitter; no topic can. Once engaged,
fresh commands are sent, and the firmware decides whether to act on them: it falls back to RC when
none has arrived for 100 ms, and takes them again when they return.

Fields and constants after https://github.com/rosflight/rosflight_ros_pkgs (rosflight_msgs) and
https://github.com/rosflight/roscopter (roscopter_msgs/msg/State).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.messages.conversions import NewMessage, fill_time, nanoseconds
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    LatestStatus,
    OutgoingMessage,
    Response,
    Subscription,
)
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.frames import (
    enu_from_ned,
    flu_from_frd,
    q_enu_flu_xyzw_from_ned_frd_wxyz,
)
from quad_mpc_ros.ros.bridges.handover import Stack

MODE_ROLLRATE_PITCHRATE_YAWRATE_THROTTLE = 1
IGNORE_NONE = 0
_VALUES = 10
_THROTTLE, _RATES = 2, slice(3, 6)  # u = Fx, Fy, Fz, Qx, Qy, Qz, …; Fz is the throttle

_STATUS_TIMEOUT = 2.0  # s


def odometry_from_state(message: Any) -> OdometrySample:
    """Return the values of a ``roscopter_msgs/State``: NED position, body velocity, FRD.

    Raises ``ValueError`` for a quaternion without a rotation.
    """
    q = message.quat
    return OdometrySample(
        stamp_ns=nanoseconds(message.header.stamp),
        p_WB=enu_from_ned((message.p_n, message.p_e, message.p_d)),
        q_WB_xyzw=q_enu_flu_xyzw_from_ned_frd_wxyz((q.w, q.x, q.y, q.z)),
        v_WB_B=flu_from_frd((message.v_x, message.v_y, message.v_z)),
        w_WB_B=flu_from_frd((message.p, message.q, message.r)),
    )


def odometry_from_sim_state(message: Any) -> OdometrySample:
    """Return the values of a ``rosflight_msgs/SimState``, the simulator's truth in NED, FRD.

    Raises ``ValueError`` for a quaternion without a rotation.
    """
    p, q = message.pose.position, message.pose.orientation
    v, w = message.twist.linear, message.twist.angular
    return OdometrySample(
        stamp_ns=nanoseconds(message.header.stamp),
        p_WB=enu_from_ned((p.x, p.y, p.z)),
        q_WB_xyzw=q_enu_flu_xyzw_from_ned_frd_wxyz((q.w, q.x, q.y, q.z)),
        v_WB_B=flu_from_frd((v.x, v.y, v.z)),
        w_WB_B=flu_from_frd((w.x, w.y, w.z)),
    )


def fill_command(message: Any, command: CommandSample, *, throttle: float, now_ns: int) -> None:
    """Write throttle [0, 1] and body rates [rad/s, FRD] into a ``rosflight_msgs/Command``."""
    fill_time(message.header.stamp, now_ns)
    message.mode = MODE_ROLLRATE_PITCHRATE_YAWRATE_THROTTLE
    message.ignore = IGNORE_NONE
    rates_frd = flu_from_frd(command.w_WB_B)
    if hasattr(message, "u"):
        u = np.zeros(_VALUES, dtype=np.float32)
        u[_THROTTLE] = throttle
        u[_RATES] = rates_frd
        message.u = u
    else:  # the first releases of ROSflight 2, and its documentation
        message.qx, message.qy, message.qz = rates_frd.tolist()
        message.fx, message.fy, message.fz = 0.0, 0.0, throttle


_STATES = {
    "estimator": ("roscopter_msgs/msg/State", odometry_from_state),
    "truth": ("rosflight_msgs/msg/SimState", odometry_from_sim_state),
}


@dataclass(frozen=True, kw_only=True)
class RosflightConfig(BridgeConfig):
    """Parameters of the ROSflight bridge."""

    owner = "rosflight_bridge"

    mpc_command_topic: str = parameter(
        "mpc/command",
        doc="Topic of the MPC's commands, to be remapped for the mpc node as well: in the root "
        "namespace /command is ROSflight's, of another type.",
        advanced=True,
    )
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
    streams = True
    patient = True

    def __init__(self, config: RosflightConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        type_name, self._odometry_of = _STATES[config.state]
        truth = config.state == "truth"
        self._state_topic = config.truth_topic if truth else config.estimator_topic
        self._status = LatestStatus(timeout=_STATUS_TIMEOUT)
        state = Topic(name=self._state_topic, type_name=type_name)
        status = Topic(name=config.status_topic, type_name="rosflight_msgs/msg/Status")
        battery = Topic(name=config.battery_topic, type_name="rosflight_msgs/msg/BatteryStatus")
        self.subscriptions = [
            Subscription(topic=state, receive=self._on_state),
            Subscription(topic=status, receive=self._status.receive),
            *self._battery_subscription(battery),
        ]
        self._command = Topic(
            name=config.command_topic, type_name="rosflight_msgs/msg/Command", reliable=True
        )
        self.publications = (self._command,)

    def _arm(self, wanted: bool) -> Response:
        return Response(accepted=False, text="ROSflight is armed by the RC transmitter only")

    def _stack(self, now_ns: int) -> Stack:
        status = self._status.value(now_ns=now_ns)
        if status is None:
            fault = f"no status within {_STATUS_TIMEOUT:g} s on {self._config.status_topic}"
            return Stack(fault=fault)
        if status.failsafe:
            return Stack(fault="ROSflight is in failsafe")
        return Stack(takes_setpoints=bool(status.offboard), armed=bool(status.armed))

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        message = self._new(self._command.type_name)
        fill_command(
            message,
            command,
            throttle=self.thrust.stack_throttle(command.throttle),
            now_ns=now_ns,
        )
        return [OutgoingMessage(topic=self._command, message=message)]

    def _on_state(self, message: Any, now_ns: int) -> OdometrySample | None:
        odometry = self._converted(self._state_topic, lambda: self._odometry_of(message))
        return self._passed_on(odometry, now_ns=now_ns)
