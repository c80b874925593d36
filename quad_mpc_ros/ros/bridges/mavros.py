# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bridge to PX4 with MAVROS (mavros_msgs); MAVROS converts from ENU and FLU.

The setpoints are the heartbeat: they must be sent before the switch to OFFBOARD, and PX4
automatically returns to OFFBOARD when setpoints return.

Fields and constants: https://github.com/mavlink/mavros (mavros_msgs/msg/AttitudeTarget).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.ros.bridges.bridge import (
    FORCED,
    Bridge,
    Outgoing,
    OutgoingMessage,
    Response,
    Subscription,
    command_result,
)
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.handover import LatestStatus, Stack

IGNORE_ATTITUDE = 128  # and no bit of a rate or of the thrust
COMPONENT_ARM_DISARM = 400  # MAV_CMD

_STATE_TIMEOUT = 3.0  # s: MAVROS publishes it with each heartbeat of the autopilot, once a second
_SETPOINT_MODE, _RELEASE_MODE = "OFFBOARD", "AUTO.LOITER"


def fill_attitude_target(
    message: Any, command: CommandSample, *, throttle: float, now_ns: int
) -> None:
    """Write body rates [rad/s, FLU] and throttle [0, 1] into an ``AttitudeTarget``."""
    conversions.fill_header(message.header, now_ns, command.frame_id)
    message.type_mask = IGNORE_ATTITUDE
    conversions.fill_vector(message.body_rate, command.w_WB_B.tolist())
    message.thrust = throttle


@dataclass(frozen=True, kw_only=True)
class MavrosConfig(BridgeConfig):
    """Parameters of the MAVROS bridge."""

    owner = "mavros_bridge"

    mavros: str = parameter("/mavros", doc="Namespace of MAVROS.")


class MavrosBridge(Bridge):
    """Bridge with attitude targets (body rates) out; local odometry and state in."""

    name = "mavros_bridge"
    packages = ("mavros_msgs",)
    how_to_get = "sudo apt install ros-jazzy-mavros-msgs"
    Config = MavrosConfig
    warm_up = 1.1  # for more than a second
    streams = True

    def __init__(self, config: MavrosConfig, new: NewMessage) -> None:
        super().__init__(config, new, namespace=config.mavros)
        self._state = LatestStatus(timeout=_STATE_TIMEOUT)
        state = self._topic("state", "mavros_msgs/msg/State", reliable=True, depth=10)
        battery = self._topic("battery", "sensor_msgs/msg/BatteryState")
        self.subscriptions = [
            self._odometry_subscription(f"{config.mavros}/local_position/odom"),
            Subscription(topic=state, receive=self._state.receive),
            *self._battery_subscription(battery),
        ]
        self._target = self._topic(
            "setpoint_raw/attitude",
            "mavros_msgs/msg/AttitudeTarget",
            reliable=True,  # matches any subscription
        )
        self.publications = (self._target,)
        self._set_mode = self._service("set_mode", "mavros_msgs/srv/SetMode")
        self._arm_service = self._service("cmd/arming", "mavros_msgs/srv/CommandBool")
        self._command = self._service("cmd/command", "mavros_msgs/srv/CommandLong")
        self.services = self._set_mode, self._arm_service, self._command

    def _stack(self, now_ns: int) -> Stack:
        state = self._state.value(now_ns=now_ns)
        if state is None:
            fault = f"no state within {_STATE_TIMEOUT:g} s on {self._config.mavros}/state"
            return Stack(fault=fault)
        if not state.connected:
            return Stack(fault="MAVROS is not connected to PX4")
        return Stack(
            takes_setpoints=state.mode == _SETPOINT_MODE,
            armed=bool(state.armed),
            exit_reason=f"PX4's mode is {state.mode}",
        )

    def _arm(self, wanted: bool) -> Response:
        what = "arming" if wanted else "disarming"
        receive = functools.partial(self._on_arming, what)
        if wanted:
            call = self._call(self._arm_service, receive=receive, value=True)
        else:  # the arming service cannot force it
            call = self._call(
                self._command,
                receive=receive,
                command=COMPONENT_ARM_DISARM,
                param1=0.0,
                param2=FORCED,
            )
        return Response(accepted=True, text=f"asked for {what}", calls=[call])

    def _on_arming(self, what: str, response: Any) -> None:
        if not response.success:
            result = command_result(int(response.result))
            self._refuse_arming(f"PX4 refuses {what}: {result}")

    def _switch(self) -> list[Outgoing]:
        return [self._call(self._set_mode, custom_mode=_SETPOINT_MODE)]

    def _switch_back(self, now_ns: int) -> Response:
        call = self._call(self._set_mode, custom_mode=_RELEASE_MODE)
        return Response(accepted=True, text=f"requested mode {_RELEASE_MODE}", calls=[call])

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        target, throttle = (
            self._message(self._target),
            self.thrust.stack_throttle(command.throttle),
        )
        fill_attitude_target(target.message, command, throttle=throttle, now_ns=now_ns)
        return [target]
