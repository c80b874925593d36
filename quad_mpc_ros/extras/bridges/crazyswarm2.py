# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Crazyswarm2 (geometry_msgs, nav_msgs).

The firmware keeps the thrust locked until it receives a setpoint with thrust 0. Without setpoints
the firmware levels after half a second and cuts the motors after two seconds, unless their end was
announced. Rates require ``flightmode.stabModeRoll`` and ``stabModePitch`` 0, set by the user.

``cmd_vel_legacy`` has the four numbers of the Crazyflie's legacy setpoint. The server negates
linear.x for the pitch, and cflib negates the value again. In the firmware pitch is nose-up and,
only in this setpoint, yaw clockwise: https://imrclab.github.io/crazyswarm2 and
https://www.bitcraze.io/documentation/repository/crazyflie-firmware/master (commanders).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.control.model.state import with_body_twist
from quad_mpc_ros.extras.bridges import crtp
from quad_mpc_ros.messages.conversions import NewMessage, odometry_from_message
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    OutgoingMessage,
    Response,
    Subscription,
)
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.handover import LatestStatus, Stack

_LOCK_TIMEOUT_NS = 2_000_000_000
_MAX_GAP_NS = 200_000_000  # between two odometries
# The radio may lose a packet.
_UNLOCKING_SETPOINTS = 3
_STATUS_TIMEOUT = 10.0  # s: the server logs it once a second or less
_SETPOINT_TIMEOUT_MS = 100  # until the firmware's own commander takes over


class RateDifferentiator:
    """Body rates from differences of successive attitudes, delayed by half a period."""

    def __init__(self) -> None:
        self._before: OdometrySample | None = None

    def completed(self, odometry: OdometrySample) -> OdometrySample | None:
        """Return an odometry with body rates; None for the first odometry and after a gap.

        Raises ``ValueError`` for a quaternion without a rotation.
        """
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        before, self._before = self._before, odometry
        if before is None:
            return None
        gap_ns = odometry.stamp_ns - before.stamp_ns
        if not 0 < gap_ns <= _MAX_GAP_NS:
            return None
        R_before = so3.rotation_from_quaternion_xyzw(before.q_WB_xyzw)
        return dataclasses.replace(odometry, w_WB_B=1e9 / gap_ns * so3.log(R_before.T @ R_WB))


def odometry_from_odom(message: Any) -> OdometrySample:
    """Return the odometry in the server's ``odom``: world velocity, no body rates.

    Raises ``ValueError`` for a quaternion without a rotation.
    """
    odometry = dataclasses.replace(odometry_from_message(message), w_WB_B=np.zeros(3))
    return with_body_twist(odometry)


def fill_setpoint(message: Any, command: CommandSample, *, throttle: float) -> None:
    """Write body rates [deg/s] and throttle [PWM] into the ``Twist`` of ``cmd_vel_legacy``."""
    p, q, r = (math.degrees(rate) for rate in command.w_WB_B.tolist())
    message.linear.x, message.linear.y = q, p
    message.linear.z = min(throttle * crtp.PWM_FULL, float(crtp.PWM_LARGEST))
    message.angular.z = -r


@dataclass(frozen=True, kw_only=True)
class Crazyswarm2Config(BridgeConfig):
    """Parameters of the Crazyswarm2 bridge."""

    owner = "crazyswarm2_bridge"

    crazyflie: str = parameter("/cf231", doc="Name of the Crazyflie, as a namespace.")


class Crazyswarm2Bridge(Bridge):
    """Legacy setpoints with rates in degrees and thrust in PWM out, odometry in."""

    name = "crazyswarm2_bridge"
    packages = ("crazyflie_interfaces",)
    how_to_get = (
        "install Crazyswarm2 (https://imrclab.github.io/crazyswarm2/installation.html), or build "
        "crazyflie_interfaces of https://github.com/IMRCLab/crazyswarm2 with colcon"
    )
    Config = Crazyswarm2Config

    def __init__(self, config: Crazyswarm2Config, new: NewMessage) -> None:
        super().__init__(config, new, namespace=config.crazyflie)
        self._setpoint = self._topic("cmd_vel_legacy", "geometry_msgs/msg/Twist", reliable=True)
        self.publications = (self._setpoint,)
        self._arm_service = self._service("arm", "crazyflie_interfaces/srv/Arm")
        self._stop = self._service(
            "notify_setpoints_stop", "crazyflie_interfaces/srv/NotifySetpointsStop"
        )
        self._go_to = self._service("go_to", "crazyflie_interfaces/srv/GoTo")
        self.services = self._arm_service, self._stop, self._go_to
        # A best-effort subscription matches any publisher.
        odometry = self._topic("odom", "nav_msgs/msg/Odometry")
        status = self._topic("status", "crazyflie_interfaces/msg/Status")
        self.subscriptions = (
            Subscription(topic=odometry, receive=self._on_odometry),
            Subscription(topic=status, receive=self._on_status),
        )
        self._differentiator = RateDifferentiator()
        self._status = LatestStatus(timeout=_STATUS_TIMEOUT)
        self._unlocking = 0
        self._sent_ns: int | None = None

    def landed(self, *, now_ns: int) -> bool | None:
        """Return whether the supervisor reports that the vehicle does not fly."""
        status = self._status.value(now_ns=now_ns)
        return None if status is None else not status.supervisor_info & crtp.IS_FLYING

    def _stack(self, now_ns: int) -> Stack:
        """Return whether the vehicle can fly and, if its status arrives, is armed."""
        status = self._status.value(now_ns=now_ns)
        if status is None:
            return Stack(takes_setpoints=True, armed=self._unlocked)
        if status.supervisor_info & crtp.IS_TUMBLED:
            return Stack(fault="the Crazyflie is upside down")
        if status.supervisor_info & crtp.IS_LOCKED:
            return Stack(fault="the Crazyflie is locked: restart it")
        armed = bool(status.supervisor_info & crtp.IS_ARMED)
        return Stack(takes_setpoints=True, armed=armed and self._unlocked)

    @property
    def _unlocked(self) -> bool:
        return self._sent_ns is not None and self._unlocking == 0

    def _arm(self, wanted: bool) -> Response:
        call = self._call(self._arm_service, arm=wanted)
        if wanted:
            return Response(accepted=True, text="requested arming", calls=[call])
        messages = [self._message(self._setpoint)]  # zeros stop firmware without arming
        return Response(accepted=True, text="requested disarming", messages=messages, calls=[call])

    def _reports_armed(self, wanted: bool, now_ns: int) -> bool | None:
        status = self._status.value(now_ns=now_ns)
        return None if status is None else crtp.is_armed(status.supervisor_info, wanted=wanted)

    def _switch_back(self, now_ns: int) -> Response:
        """Let the firmware hold the position: without setpoints it would cut the motors."""
        if self._sent_ns is None or now_ns - self._sent_ns >= _LOCK_TIMEOUT_NS:
            return Response(accepted=True, text="released")
        stop = self._call(self._stop, group_mask=0, remain_valid_millisecs=_SETPOINT_TIMEOUT_MS)
        stay = self._call(self._go_to, group_mask=0, relative=True, yaw=0.0)
        stay.request.duration.sec = 1
        calls = [stop] if self.landed(now_ns=now_ns) else [stop, stay]
        return Response(accepted=True, text="requested position hold", calls=calls)

    def _update_ground(self, odometry: OdometrySample, now_ns: int) -> None:
        """The supervisor reports the state."""

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        if self._sent_ns is None or now_ns - self._sent_ns >= _LOCK_TIMEOUT_NS:
            self._unlocking = _UNLOCKING_SETPOINTS
        self._sent_ns = now_ns
        setpoint = self._message(self._setpoint)
        if self._unlocking > 0 or not self._stack(now_ns).armed:
            self._unlocking = max(self._unlocking - 1, 0)  # with a setpoint of zeros
        else:
            throttle = self.thrust.stack_throttle(command.throttle)
            fill_setpoint(setpoint.message, command, throttle=throttle)
        return [setpoint]

    def _on_odometry(self, message: Any, now_ns: int) -> OdometrySample | None:
        odometry = self._converted(
            "odom", lambda: self._differentiator.completed(odometry_from_odom(message))
        )
        return self._passed_on(odometry, now_ns=now_ns)

    def _on_status(self, message: Any, now_ns: int) -> None:
        self._status.receive(message, now_ns)
        self._receive_voltage(float(message.battery_voltage), now_ns)
