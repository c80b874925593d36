# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""ROSflight 2 (rosflight_msgs, roscopter_msgs), NED and FRD.

The safety pilot arms and hands over with switches of the RC transmitter; ROS topics cannot. Once
engaged, the bridge sends fresh commands. The firmware applies a command only when a frame of the
receiver arrives. Without commands for 100 ms, the firmware uses RC until the next one.
``offboard`` of the status means that commands arrive, ``rc_override`` that RC overrides them.

Fields and constants as in https://github.com/rosflight/rosflight_ros_pkgs (rosflight_msgs) and
https://github.com/rosflight/roscopter (roscopter_msgs/msg/State).
"""

from __future__ import annotations

import dataclasses
import functools
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.messages.conversions import NewMessage, fill_time, nanoseconds
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
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
from quad_mpc_ros.ros.bridges.handover import LatestStatus, Stack, is_old

MODE_ROLLRATE_PITCHRATE_YAWRATE_THROTTLE = 1
IGNORE_NONE = 0
_COMMAND_LENGTH = 10
_THROTTLE, _RATES = 2, slice(3, 6)  # u = Fx, Fy, Fz, Qx, Qy, Qz, …; Fz is the throttle

# Topics of ROScopter's estimator and of rosflight_io, which may be remapped.
_ESTIMATE, _STATUS, _RC = "/estimated_state", "/status", "/rc_raw"
_STATUS_TIMEOUT = 2.0  # s
_RC_TIMEOUT = 0.5  # s
_RC_RATE_FRAMES = 20  # for the RC rate
_MIN_RC_RATE = 100.0  # Hz

# Parameters of the firmware that are requested on engaging.
_MAX_THROTTLE_NAME, _MIN_THROTTLE_NAME = "RC_MAX_THR", "TAKE_MIN_THR"
_RATE_INTEGRAL_NAMES = ("PID_ROLL_RATE_I", "PID_PITCH_RATE_I")
_QUERIED = (_MAX_THROTTLE_NAME, _MIN_THROTTLE_NAME, *_RATE_INTEGRAL_NAMES)
_SCALE_TOLERANCE = 0.005

# Bits of the status: RC overrides the throttle (the lowest one applies), and arming errors.
OVERRIDE_T = 0x20
ERRORS = {
    0x01: "no mixer (PRIMARY_MIXER)",
    0x02: "no IMU",
    0x04: "RC lost",
    0x08: "unhealthy estimator",
    0x10: "time goes backwards",
    0x20: "IMU not calibrated (calibrate_imu)",
    0x80: "FAILSAFE_THR is not between 0 and 1",
}


def odometry_from_state(message: Any) -> OdometrySample:
    """Return the odometry in a ``roscopter_msgs/State``: NED position, body velocity, FRD.

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


def fill_command(message: Any, command: CommandSample, *, throttle: float, now_ns: int) -> None:
    """Write throttle [0, 1] and body rates [rad/s, FRD] into a ``rosflight_msgs/Command``."""
    fill_time(message.header.stamp, now_ns)
    message.mode = MODE_ROLLRATE_PITCHRATE_YAWRATE_THROTTLE
    message.ignore = IGNORE_NONE
    rates_frd = flu_from_frd(command.w_WB_B)
    if hasattr(message, "u"):
        u = np.zeros(_COMMAND_LENGTH, dtype=np.float32)
        u[_THROTTLE] = throttle
        u[_RATES] = rates_frd
        message.u = u
    else:  # the first releases of ROSflight 2, and its documentation
        message.qx, message.qy, message.qz = rates_frd.tolist()
        message.fx, message.fy, message.fz = 0.0, 0.0, throttle


@dataclass(frozen=True, kw_only=True)
class RosflightConfig(BridgeConfig):
    """Parameters of the ROSflight bridge."""

    owner = "rosflight_bridge"

    mpc_command_topic: str = parameter(
        "mpc/command",
        doc="Topic of the MPC's commands. Remap it for the mpc node, too: in the root namespace, "
        "ROSflight uses /command with another type.",
        advanced=True,
    )
    rc_max_throttle: float = parameter(
        0.7,
        doc="RC_MAX_THR of the firmware, which also scales the commanded throttle. The thrust "
        "map applies to the motor outputs.",
        above=0.0,
        maximum=1.0,
    )


class RosflightBridge(Bridge):
    """Offboard commands out, estimated state and status in."""

    name = "rosflight_bridge"
    packages = ("rosflight_msgs", "roscopter_msgs")
    how_to_get = (
        "clone https://github.com/rosflight/rosflight_ros_pkgs and "
        "https://github.com/rosflight/roscopter into the workspace and build them with colcon"
    )
    Config = RosflightConfig
    streams = True
    pilot_switches_mode = True

    def __init__(self, config: RosflightConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        self._status = LatestStatus(timeout=_STATUS_TIMEOUT)
        self._rc_ns: deque[int] = deque(maxlen=_RC_RATE_FRAMES)
        self._scale_fault = ""
        self._parameters = ("/param_get", "rosflight_msgs/srv/ParamGet")
        self.services = (self._parameters,)
        state = Topic(name=_ESTIMATE, type_name="roscopter_msgs/msg/State")
        status = Topic(name=_STATUS, type_name="rosflight_msgs/msg/Status")
        rc = Topic(name=_RC, type_name="rosflight_msgs/msg/RCRaw")
        battery = Topic(name="/battery", type_name="rosflight_msgs/msg/BatteryStatus")
        self.subscriptions = [
            Subscription(topic=state, receive=self._on_state),
            Subscription(topic=status, receive=self._status.receive),
            Subscription(topic=rc, receive=self._on_rc),
            *self._battery_subscription(battery),
        ]
        self._command = Topic(
            name="/command", type_name="rosflight_msgs/msg/Command", reliable=True
        )
        self.publications = (self._command,)

    def engage(self, wanted: bool, *, now_ns: int) -> Response:
        """Engage the MPC unless the firmware would ignore it, or release."""
        blocker = self._rc_blocker(now_ns) if wanted else ""
        if blocker:
            return Response(accepted=False, text=blocker)
        if wanted:
            self._scale_fault = ""  # checked again with the answer
        response = super().engage(wanted, now_ns=now_ns)
        if not (wanted and response.accepted):
            return response
        calls = []
        for name in _QUERIED:
            receive = functools.partial(self._on_parameter, name)
            calls.append(self._call(self._parameters, receive=receive, optional=True, name=name))
        return dataclasses.replace(response, calls=calls)

    def _on_parameter(self, name: str, response: Any) -> None:
        """Check a parameter of the firmware."""
        if not response.exists:
            return
        value, ours = float(response.value), self._config.rc_max_throttle
        if name == _MAX_THROTTLE_NAME and abs(value - ours) > _SCALE_TOLERANCE:
            self._scale_fault = (
                f"RC_MAX_THR is {value:.3g} and rc_max_throttle {ours:.3g}: thrust would be "
                f"{value / ours:.2f} of the commanded thrust; set equal values"
            )
        if name in _RATE_INTEGRAL_NAMES and value == 0.0:
            self._warnings.append(f"{name} is 0: an off-centre weight makes the vehicle turn")
        if name == _MIN_THROTTLE_NAME and value != 0.0:
            self._warnings.append(
                "TAKE_MIN_THR is 1: the pilot's stick limits the throttle; raise it fully to fly"
            )

    def _rc_blocker(self, now_ns: int) -> str:
        """Return the reason why the firmware would ignore commands, or an empty string."""
        status = self._status.value(now_ns=now_ns)
        if status is None or status.failsafe:
            return ""  # reported by the stack's fault
        errors = [text for bit, text in ERRORS.items() if status.error_code & bit]
        if errors:
            return f"ROSflight does not arm: {', '.join(errors)}"
        newest_ns = self._rc_ns[-1] if self._rc_ns else None
        if newest_ns is None or is_old(newest_ns, now_ns, round(1e9 * _RC_TIMEOUT)):
            return (
                f"no RC frame within {_RC_TIMEOUT:g} s on {_RC}: ROSflight applies a command "
                "only when an RC frame arrives"
            )
        span_ns = newest_ns - self._rc_ns[0]
        rate = 1e9 * (len(self._rc_ns) - 1) / span_ns if span_ns > 0 else 0.0
        if 0.0 < rate < _MIN_RC_RATE:
            self._warnings.append(
                f"RC frames arrive at {rate:.0f} Hz, and ROSflight applies commands only with a "
                f"frame: add {500.0 / rate:.0f} ms to mpc.input_delay, or raise the rate"
            )
        return ""

    def _arm(self, wanted: bool) -> Response:
        return Response(accepted=False, text="ROSflight is armed by the RC transmitter only")

    def _stack(self, now_ns: int) -> Stack:
        status = self._status.value(now_ns=now_ns)
        if status is None:
            fault = f"no status within {_STATUS_TIMEOUT:g} s on {_STATUS}"
            return Stack(fault=fault)
        if status.failsafe:
            return Stack(fault="ROSflight is in failsafe")
        if self._scale_fault:
            return Stack(fault=self._scale_fault)
        followed = bool(status.offboard) and not status.rc_override & ~OVERRIDE_T
        return Stack(takes_setpoints=followed, armed=bool(status.armed))

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        throttle = self.thrust.stack_throttle(command.throttle) / self._config.rc_max_throttle
        outgoing = self._message(self._command)
        fill_command(outgoing.message, command, throttle=min(throttle, 1.0), now_ns=now_ns)
        return [outgoing]

    def _on_state(self, message: Any, now_ns: int) -> OdometrySample | None:
        odometry = self._converted(_ESTIMATE, lambda: odometry_from_state(message))
        return self._passed_on(odometry, now_ns=now_ns)

    def _on_rc(self, message: Any, now_ns: int) -> None:
        if self._rc_ns and now_ns < self._rc_ns[-1]:  # the clock was set
            self._rc_ns.clear()
        self._rc_ns.append(now_ns)
