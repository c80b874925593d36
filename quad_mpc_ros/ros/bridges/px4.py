# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bridge to PX4 over uXRCE-DDS (px4_msgs), in NED and FRD.

The heartbeat ``offboard_control_mode`` must be sent for a second before PX4 switches to offboard.
PX4 has no failsafe for setpoints that stop while the heartbeat continues, so a heartbeat is sent
only with a fresh command. PX4 stays ready for offboard mode after a failsafe or disarming: a
single heartbeat would resume offboard flight. So no heartbeat is sent before a request to engage.

Fields and constants: https://github.com/PX4/px4_msgs.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, reported_variance
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
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
from quad_mpc_ros.ros.bridges.frames import (
    enu_from_ned,
    flu_from_frd,
    q_enu_flu_xyzw_from_ned_frd_wxyz,
)
from quad_mpc_ros.ros.bridges.handover import Handover, HandoverState, LatestStatus, Stack
from quad_mpc_ros.ros.bridges.px4_mode import DENIED, MODE_NAME, UNRESPONSIVE, Px4Mode

POSE_FRAME_NED, POSE_FRAME_FRD = 1, 2
VELOCITY_FRAME_NED, VELOCITY_FRAME_FRD, VELOCITY_FRAME_BODY_FRD = 1, 2, 3
NAVIGATION_STATE_OFFBOARD = 14
ARMING_STATE_ARMED = 2

VEHICLE_CMD_DO_SET_MODE = 176
VEHICLE_CMD_COMPONENT_ARM_DISARM = 400
# Custom mode, main mode, sub mode: offboard, and hold (auto, loiter).
OFFBOARD, HOLD = (1.0, 6.0, 0.0), (1.0, 4.0, 3.0)

_POSE_FRAMES = {POSE_FRAME_NED: "NED", POSE_FRAME_FRD: "FRD"}

_STATUS_TIMEOUT = 1.5  # s: published at 2 Hz and on change; DDS forwards 5 Hz at most
_MODE_TIMEOUT = 0.5  # s: published at 2 Hz and on change
_LAND_TIMEOUT = 2.5  # s: published at 1 Hz and on change
_ACCEPTED, _IN_PROGRESS = 0, 5
_HOLD_RETRY_NS = 1_000_000_000


def odometry_from_vehicle_odometry(message: Any) -> OdometrySample:
    """Return the odometry in a ``VehicleOdometry``, stamped with its sample time.

    Raises ``ValueError`` for an unknown frame, a velocity in another world frame than the pose,
    or an attitude marked as invalid. Other invalid fields stay NaN.
    """
    pose_frame, velocity_frame = int(message.pose_frame), int(message.velocity_frame)
    if pose_frame not in _POSE_FRAMES:
        raise ValueError(f"pose_frame {pose_frame}, expected 1 (NED) or 2 (FRD)")
    q_WB_xyzw = q_enu_flu_xyzw_from_ned_frd_wxyz(message.q)
    if velocity_frame == VELOCITY_FRAME_BODY_FRD:
        v_WB_B = flu_from_frd(message.velocity)
    elif velocity_frame == pose_frame:
        v_WB_B = so3.rotation_from_quaternion_xyzw(q_WB_xyzw).T @ enu_from_ned(message.velocity)
    else:
        raise ValueError(
            f"velocity_frame {velocity_frame} with a pose in {_POSE_FRAMES[pose_frame]}, "
            f"expected {pose_frame} or 3 (body FRD)"
        )
    return OdometrySample(
        stamp_ns=1000 * int(message.timestamp_sample or message.timestamp),
        p_WB=enu_from_ned(message.position),
        q_WB_xyzw=q_WB_xyzw,
        v_WB_B=v_WB_B,
        w_WB_B=flu_from_frd(message.angular_velocity),
        v_variance=reported_variance(message.velocity_variance),
    )


def fill_vehicle_rates_setpoint(message: Any, command: CommandSample, *, throttle: float) -> None:
    """Write body rates [rad/s] into a ``VehicleRatesSetpoint`` (FRD), throttle along -z.

    The timestamp is 0 in all messages to PX4, which sets its own.
    """
    p, q, r = flu_from_frd(command.w_WB_B).tolist()
    message.roll, message.pitch, message.yaw = p, q, r
    message.thrust_body = np.array((0.0, 0.0, -throttle), dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Px4Config(BridgeConfig):
    """Parameters of the PX4 bridge."""

    owner = "px4_bridge"

    fmu: str = parameter(
        "/fmu", doc="Prefix of PX4's topics, such as /px4_1/fmu for the client key px4_1."
    )
    target_system: int = parameter(
        1, doc="MAV_SYS_ID of the vehicle to arm and to switch.", minimum=1, maximum=255
    )
    mode: str = parameter(
        "offboard",
        doc="PX4's mode for the MPC: offboard, or external for a mode named quad MPC, which is "
        "selected in the ground station or with the transmitter.",
        choices=("offboard", "external"),
    )


class Px4Bridge(Bridge):
    """Bridge with heartbeat and rate setpoints out; vehicle odometry and status in."""

    name = "px4_bridge"
    packages = ("px4_msgs",)
    how_to_get = (
        "clone https://github.com/PX4/px4_msgs on the branch of the vehicle's PX4 release into "
        "the workspace and build it with colcon"
    )
    Config = Px4Config
    warm_up = 1.1  # for more than a second
    streams = True

    @classmethod
    def configured(cls, config: Any, new: NewMessage) -> Bridge:
        """Return the bridge for the configured mode of PX4."""
        return ExternalModeBridge(config, new) if config.mode == "external" else cls(config, new)

    def __init__(self, config: Px4Config, new: NewMessage) -> None:
        super().__init__(config, new, namespace=config.fmu)
        self._status = LatestStatus(timeout=_STATUS_TIMEOUT)
        self._mode = LatestStatus(timeout=_MODE_TIMEOUT)
        self._land = LatestStatus(timeout=_LAND_TIMEOUT)
        self._resets: tuple[int, int] | None = None
        self._first_ns: int | None = None  # arrival of the first odometry
        odometry = self._versioned("out/vehicle_odometry", "VehicleOdometry")
        status = self._versioned("out/vehicle_status", "VehicleStatus")
        self._status_name = status.name
        mode = self._versioned("out/vehicle_control_mode", "VehicleControlMode")
        land = self._versioned("out/vehicle_land_detected", "VehicleLandDetected")
        ack = self._versioned("out/vehicle_command_ack", "VehicleCommandAck")
        battery = self._versioned("out/battery_status", "BatteryStatus")
        self.subscriptions = [
            Subscription(topic=odometry, receive=self._on_odometry),
            Subscription(topic=status, receive=self._on_status),
            Subscription(topic=mode, receive=self._mode.receive),
            Subscription(topic=land, receive=self._on_land),
            Subscription(topic=ack, receive=self._on_ack),
            *self._battery_subscription(battery, field="voltage_v"),
        ]
        self._heartbeat = self._versioned("in/offboard_control_mode", "OffboardControlMode")
        self._rates = self._versioned("in/vehicle_rates_setpoint", "VehicleRatesSetpoint")
        self._command = self._versioned("in/vehicle_command", "VehicleCommand")
        self.publications = self._heartbeat, self._rates, self._command

    def landed(self, *, now_ns: int) -> bool | None:
        """Return the state of PX4's land detector, or else a state derived from arming."""
        land = self._land.value(now_ns=now_ns)
        return super().landed(now_ns=now_ns) if land is None else bool(land.landed)

    def _stack(self, now_ns: int) -> Stack:
        status, mode = self._status.value(now_ns=now_ns), self._mode.value(now_ns=now_ns)
        if status is None:
            fault = f"no vehicle_status within {_STATUS_TIMEOUT:g} s on {self._status_name}"
            waited = 0 if self._first_ns is None else now_ns - self._first_ns
            if self._status.is_empty and waited > _STATUS_TIMEOUT * 1e9:
                fault += ", but odometry: px4_msgs is not of the vehicle's PX4 release"
            return Stack(fault=fault)
        selected = [self._selects_mpc(status)]
        armed = [status.arming_state == ARMING_STATE_ARMED]
        if mode is not None:  # either may report a change first
            selected.append(bool(mode.flag_control_offboard_enabled))
            armed.append(bool(mode.flag_armed))
        exit_reason = "PX4 switched the mode in a failsafe"
        if not status.failsafe:
            exit_reason = "a pilot, a ground station or another node switched PX4's mode"
        return Stack(takes_setpoints=all(selected), armed=all(armed), exit_reason=exit_reason)

    def _selects_mpc(self, status: Any) -> bool:
        """Return whether PX4 is in the mode for setpoints, by ``VehicleStatus``."""
        return bool(status.nav_state == NAVIGATION_STATE_OFFBOARD)

    def _arm(self, wanted: bool) -> Response:
        parameters = (1.0, 0.0, 0.0) if wanted else (0.0, FORCED, 0.0)
        command = self._vehicle_command(VEHICLE_CMD_COMPONENT_ARM_DISARM, parameters)
        what = "arming" if wanted else "disarming"
        return Response(accepted=True, text=f"asked for {what}", messages=[command])

    def _switch(self) -> list[Outgoing]:
        return [self._vehicle_command(VEHICLE_CMD_DO_SET_MODE, OFFBOARD)]

    def _switch_back(self, now_ns: int) -> Response:
        command = self._vehicle_command(VEHICLE_CMD_DO_SET_MODE, HOLD)
        return Response(accepted=True, text="requested hold mode", messages=[command])

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        heartbeat = self._message(self._heartbeat, body_rate=True)
        if not self._stack(now_ns).takes_setpoints:
            self.silence = "heartbeat only: the vehicle is not in offboard mode"
            return [heartbeat]
        return [heartbeat, self._setpoint(command)]

    def _setpoint(self, command: CommandSample) -> OutgoingMessage:
        rates, throttle = self._message(self._rates), self.thrust.stack_throttle(command.throttle)
        fill_vehicle_rates_setpoint(rates.message, command, throttle=throttle)
        return rates

    def _on_status(self, message: Any, now_ns: int) -> None:
        self._status.receive(message, now_ns)

    def _on_land(self, message: Any, now_ns: int) -> None:
        self._land.receive(message, now_ns)

    def _on_odometry(self, message: Any, now_ns: int) -> OdometrySample | None:
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        odometry = self._converted(
            "vehicle_odometry", lambda: odometry_from_vehicle_odometry(message)
        )
        if odometry is None:
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

    def _on_ack(self, message: Any, now_ns: int) -> None:
        if message.result in (_ACCEPTED, _IN_PROGRESS):
            return
        result, reason = command_result(int(message.result)), self._refusal_reason(now_ns)
        if message.command == VEHICLE_CMD_COMPONENT_ARM_DISARM:
            self._refuse_arming(f"PX4 refuses to arm or disarm ({result}): {reason}")
        else:
            self._warnings.append(f"PX4 refuses command {message.command} ({result}): {reason}")

    def _refusal_reason(self, now_ns: int) -> str:
        """Return the reason why PX4 refuses to arm or to switch its mode, if it is known."""
        return "see the ground station"

    def _vehicle_command(
        self, command: int, parameters: tuple[float, float, float]
    ) -> OutgoingMessage:
        return self._message(
            self._command,
            command=command,
            **dict(zip(("param1", "param2", "param3"), parameters, strict=True)),
            target_system=self._config.target_system,
            target_component=1,
            source_system=1,
            source_component=1,
            from_external=True,
        )

    def _versioned(self, path: str, kind: str) -> Topic:
        """Return a topic; its name ends in the version of the installed message, if not 0."""
        type_name = f"px4_msgs/msg/{kind}"
        try:
            version = int(getattr(type(self._new(type_name)), "MESSAGE_VERSION", 0))
        except AttributeError:
            version = 0  # px4_msgs is older than the message, which the node reports
        suffix = f"_v{version}" if version > 0 else ""
        # Not latched: an agent that starts later would receive old requests.
        return self._topic(f"{path}{suffix}", type_name)


class ExternalModeBridge(Px4Bridge):
    """Bridge to a mode of PX4 for the MPC (:mod:`.px4_mode`); selecting the mode engages the MPC.

    PX4 holds the last body rates until it finds the mode unresponsive, after more than a second.
    So the bridge requests Hold as soon as the mode is selected in flight and the MPC is released.
    """

    warm_up = 0.0
    streams = False

    def __init__(self, config: Px4Config, new: NewMessage) -> None:
        super().__init__(config, new)
        self._handover = Handover(config.handover, request=f"select the mode {MODE_NAME}")
        self._external = Px4Mode(new, self._versioned, check=self._blocking_event)
        self._selected, self._held_ns = False, 0
        self.subscriptions = [*self.subscriptions, *self._external.subscriptions]
        self.publications = self._rates, self._command, *self._external.publications

    def take_outgoing(self) -> list[Outgoing]:
        """Return the messages to send since the last call, in response to PX4's."""
        outgoing, self._external.outgoing = self._external.outgoing, []
        return [*outgoing]

    def leave(self) -> list[Outgoing]:
        """Return the messages to send at the end: Hold in flight, and the mode is removed."""
        flies = self._handover.state is HandoverState.ENGAGED
        last = self.engage(False, now_ns=0).messages if flies else []
        self._external.leave()
        return [*last, *self.take_outgoing()]

    def _stack(self, now_ns: int) -> Stack:
        stack = super()._stack(now_ns)
        return dataclasses.replace(stack, fault=stack.fault or self._external.fault)

    def _selects_mpc(self, status: Any) -> bool:
        return bool(status.nav_state == self._external.state)

    def _switch(self) -> list[Outgoing]:
        if self._selected:
            return []
        return [self._vehicle_command(VEHICLE_CMD_DO_SET_MODE, self._external.parameters)]

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        return [self._setpoint(command)]

    def _on_status(self, message: Any, now_ns: int) -> None:
        super()._on_status(message, now_ns)
        armed = message.arming_state == ARMING_STATE_ARMED
        if not armed and self._external.awaits_removal(message):
            self._external.outgoing += self._switch_back(now_ns).messages
        else:
            self._external.follow(message, armed=armed, now_ns=now_ns)
        before, self._selected = self._selected, self._selects_mpc(message)
        if self._selected and not self._stack(now_ns).takes_setpoints:
            self._external.configure()
        # A flight that was released does not resume before the mode is selected again.
        released = self._handover.state is HandoverState.RELEASED
        if self._selected and released and not (armed and before):
            response = self.engage(True, now_ns=now_ns)
            if not response.accepted:
                self._warnings.append(f"the mode {MODE_NAME} is selected, but {response.text}")

    def _on_odometry(self, message: Any, now_ns: int) -> OdometrySample | None:
        odometry = super()._on_odometry(message, now_ns)
        self._advance(now_ns)
        stack, released = self._stack(now_ns), self._handover.state is HandoverState.RELEASED
        held = abs(now_ns - self._held_ns) < _HOLD_RETRY_NS
        if released and stack.takes_setpoints and stack.armed and not held:
            self._held_ns = now_ns
            self._external.report(now_ns)  # PX4 flies back if Hold is not possible
            self._external.outgoing += self._switch_back(now_ns).messages
        return odometry

    def _on_land(self, message: Any, now_ns: int) -> None:
        before = self.landed(now_ns=now_ns)
        super()._on_land(message, now_ns)
        flies = self._handover.state is HandoverState.ENGAGED
        if flies and message.landed and before is False:
            self._external.complete()

    def _refusal_reason(self, now_ns: int) -> str:
        return self._blocking_event(now_ns)[0] or super()._refusal_reason(now_ns)

    def _blocking_event(self, now_ns: int) -> tuple[str, str]:
        """Return the reason why PX4 must not arm or run the mode, and PX4's event for it."""
        stack, state = self._stack(now_ns), self._handover.state
        if stack.fault or state is HandoverState.ENGAGED:
            return stack.fault, UNRESPONSIVE
        blocker = self._engage_blocker(now_ns)
        intended = self._status.value(now_ns=now_ns).nav_state_user_intention
        if intended == self._external.state:  # PX4 would arm before, or resume the mode
            blocker = blocker or self._handover.reason
        silent = self._handover_conditions.command.value(now_ns=now_ns) is None
        return blocker, UNRESPONSIVE if silent else DENIED
