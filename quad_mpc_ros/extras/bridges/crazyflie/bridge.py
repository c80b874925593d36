# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Crazyflie bridge: unlocking, arming, and loss of commands.

The firmware keeps the thrust locked until it receives a setpoint of zeros. Without setpoints the
firmware levels after half a second, stops the motors after two seconds in flight and **is locked
until a restart**. So if the MPC's commands stop, the bridge requests a landing by the firmware,
which needs odometry.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.extras.bridges import crtp
from quad_mpc_ros.extras.bridges.crazyflie.line import CrazyflieLine
from quad_mpc_ros.extras.bridges.crazyflie.session import Session
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    Outgoing,
    Response,
)
from quad_mpc_ros.ros.bridges.config import EstimatorConfig
from quad_mpc_ros.ros.bridges.handover import Stack, is_old

_SECOND = 1_000_000_000
_LOCK_TIMEOUT_NS = 2 * _SECOND
_TELEMETRY_PERIOD_NS = _SECOND
_ODOMETRY_TIMEOUT_NS = _SECOND // 5
# The radio may lose a packet.
_UNLOCKING_SETPOINTS = 3
_SETPOINT_TIMEOUT = 0.1  # s until the firmware's own commander takes over
_MIN_HEADING_RATIO = 0.25  # nose 60 degrees up or down: the heading turns with anything
_ZERO_SETPOINT = crtp.rate_setpoint(roll=0.0, pitch=0.0, heading=0.0, throttle=0.0)
_HOLD_DURATION, _MIN_LANDING_DURATION = 1.0, 1.0  # s


@dataclass(frozen=True, kw_only=True)
class CrazyflieLossParameters(Configuration):
    """Landing by the firmware when the MPC's commands stop in flight."""

    owner = "lost"

    after: float = parameter(
        0.15,
        doc="Time without commands after which the bridge requests landing, if odometry still "
        "arrives. Until then, and for at most 0.5 s, the firmware holds the last rates.",
        unit="s",
        above=0.0,
        maximum=0.5,
    )
    descent: float = parameter(
        0.3, doc="Descent speed, down to the last height on the ground.", unit="m/s", above=0.0
    )


@dataclass(frozen=True, kw_only=True)
class CrazyflieConfig(EstimatorConfig):
    """Parameters of the Crazyflie bridge."""

    owner = "crazyflie_bridge"

    uri: str = parameter(
        "radio://0/80/2M/E7E7E7E7E7",
        doc="Address of the Crazyflie in cflib's format: radio://, usb:// or udp://.",
    )
    external: str = parameter(
        "pose",
        doc="Part of the odometry that is sent to the onboard estimator: pose, position, or none "
        "if the onboard estimator is the source of the odometry.",
        choices=("pose", "position", "none"),
    )
    external_rate: float = parameter(
        50.0, doc="Rate of external poses.", unit="Hz", minimum=1.0, maximum=200.0
    )
    lost: CrazyflieLossParameters = dataclasses.field(default_factory=CrazyflieLossParameters)


class CrazyflieBridge(Bridge):
    """Rates and thrust out, telemetry in, over CRTP; odometry from another node."""

    name = "crazyflie_bridge"
    packages = ("nav_msgs", "cflib")
    how_to_get = "pip install 'quad_mpc_ros[crazyflie]'"
    Config = CrazyflieConfig

    def __init__(self, config: CrazyflieConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        self.line = CrazyflieLine(config.uri)
        self.subscriptions = [self._odometry_subscription(config.odometry_topic)]
        self._reader = crtp.PacketReader()
        self._session = Session()
        self._unlocking = 0
        self._sent_ns: int | None = None
        self._pose_ns: int | None = None
        self._ground_height = 0.0
        self._is_left = True  # to the firmware's own commander, or to no one yet

    def exchange(self, received: bytes, *, now_ns: int) -> bytes:
        """Receive packets, send requests, and forward the pose to the onboard estimator."""
        for packet in self._reader.read(received):
            self._session.receive(packet, now_ns=now_ns)
        telemetry = self._session.telemetry
        self._warnings += telemetry.faults
        telemetry.faults.clear()
        self._receive_voltage(telemetry.voltage, now_ns)
        self._advance(now_ns)
        packets = [
            *self._session.requests(now_ns=now_ns),
            *self._external(now_ns),
            *self._landing(now_ns),
        ]
        return b"".join(packet.framed() for packet in packets)

    def landed(self, *, now_ns: int) -> bool | None:
        """Return whether the supervisor reports that the vehicle does not fly."""
        telemetry = self._session.telemetry
        if is_old(telemetry.received_ns, now_ns, _TELEMETRY_PERIOD_NS):
            return None
        return not telemetry.info & crtp.IS_FLYING

    def _stack(self, now_ns: int) -> Stack:
        telemetry = self._session.telemetry
        if is_old(telemetry.received_ns, now_ns, _TELEMETRY_PERIOD_NS):
            return Stack(fault=f"no telemetry within 1 s from {self._config.uri}")
        if not telemetry.takes_rates:
            return Stack(fault="the Crazyflie has not confirmed its rate modes yet")
        if telemetry.info & crtp.IS_TUMBLED:
            return Stack(fault="the Crazyflie is upside down")
        if telemetry.info & crtp.IS_LOCKED:
            return Stack(fault="the Crazyflie is locked: restart it")
        is_unlocked = self._sent_ns is not None and self._unlocking == 0
        armed = bool(telemetry.info & crtp.IS_ARMED) and is_unlocked
        return Stack(takes_setpoints=True, armed=armed)

    def _arm(self, wanted: bool) -> Response:
        """Arm or disarm; firmware without arming stops with a setpoint of zeros."""
        if wanted:
            messages = [crtp.arm(True).framed()]
            return Response(accepted=True, text="requested arming", messages=messages)
        self._is_left = True
        messages = [crtp.arm(False).framed(), _ZERO_SETPOINT.framed()]
        return Response(accepted=True, text="requested disarming", messages=messages)

    def _reports_armed(self, wanted: bool, now_ns: int) -> bool | None:
        telemetry = self._session.telemetry
        if is_old(telemetry.received_ns, now_ns, _TELEMETRY_PERIOD_NS):
            return None
        return crtp.is_armed(telemetry.info, wanted=wanted)

    def _switch_back(self, now_ns: int) -> Response:
        """Let the firmware hold the position. Without setpoints the firmware stops the motors."""
        if self._is_left:
            return Response(accepted=True, text="released")
        self._is_left = True
        stop = crtp.stop_setpoints(remain_valid=_SETPOINT_TIMEOUT)
        packets = (
            [_ZERO_SETPOINT, stop]
            if self.landed(now_ns=now_ns)
            else [stop, crtp.stay(duration=_HOLD_DURATION)]
        )
        text = "requested position hold"
        return Response(accepted=True, text=text, messages=[each.framed() for each in packets])

    def _update_ground(self, odometry: OdometrySample, now_ns: int) -> None:
        """Store the height of the ground; the supervisor reports whether the vehicle flies."""
        if self.landed(now_ns=now_ns):
            self._ground_height = float(odometry.p_WB[2])

    def _messages(self, command: CommandSample, now_ns: int) -> Sequence[Outgoing]:
        if is_old(self._sent_ns, now_ns, _LOCK_TIMEOUT_NS):
            self._unlocking = _UNLOCKING_SETPOINTS
        self._sent_ns, self._is_left = now_ns, False
        if self._unlocking > 0 or not self._stack(now_ns).armed:
            self._unlocking = max(self._unlocking - 1, 0)
            return [_ZERO_SETPOINT.framed()]
        setpoint = crtp.rate_setpoint(
            roll=float(command.w_WB_B[0]),
            pitch=float(command.w_WB_B[1]),
            heading=self._heading_rate(command),
            throttle=self.thrust.stack_throttle(command.throttle),
        )
        return [setpoint.framed()]

    def _heading_rate(self, command: CommandSample) -> float:
        """Return the heading rate [rad/s] of the commanded body rates.

        The firmware controls the heading. With a body rate of 0 about z, the heading of a tilted
        vehicle that turns about y still changes.
        """
        if self._newest is None:
            return float(command.w_WB_B[2])
        up_B = so3.rotation_from_quaternion_xyzw(self._newest.q_WB_xyzw)[2]
        share = max(1.0 - float(up_B[0]) ** 2, _MIN_HEADING_RATIO)
        return float(up_B[1:] @ command.w_WB_B[1:]) / share

    def _external(self, now_ns: int) -> list[crtp.Packet]:
        """Return the newest pose for the onboard estimator, when due."""
        period_ns = round(_SECOND / self._config.external_rate)
        odometry, seen_ns = self._recent(now_ns), self._newest_ns
        if self._config.external == "none" or odometry is None or seen_ns is None:
            return []
        if self._pose_ns is not None and abs(seen_ns - self._pose_ns) < period_ns:
            return []
        self._pose_ns = seen_ns
        if self._config.external == "position":
            return [crtp.external_position(odometry.p_WB)]
        return [crtp.external_pose(odometry.p_WB, odometry.q_WB_xyzw)]

    def _landing(self, now_ns: int) -> list[crtp.Packet]:
        """Return the request to land, once after the MPC's commands stop in flight."""
        lost_ns = round(self._config.lost.after * _SECOND)
        if self._is_left or not is_old(self._sent_ns, now_ns, lost_ns):
            return []
        self._is_left = True
        odometry = self._recent(now_ns)
        if self.landed(now_ns=now_ns) is not False or odometry is None:
            return []
        above = float(odometry.p_WB[2]) - self._ground_height
        duration = max(above / self._config.lost.descent, _MIN_LANDING_DURATION)
        self._warnings.append("commands lost: requesting landing from the firmware")
        return [
            crtp.stop_setpoints(remain_valid=_SETPOINT_TIMEOUT),
            crtp.land(height=self._ground_height, duration=duration),
        ]

    def _recent(self, now_ns: int) -> OdometrySample | None:
        """Return the newest odometry; None if it is old."""
        return None if is_old(self._newest_ns, now_ns, _ODOMETRY_TIMEOUT_NS) else self._newest
