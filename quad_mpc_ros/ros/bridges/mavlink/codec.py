# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of MAVLink bytes to values in ENU and FLU, and back. No I/O, clock or rules.

Messages: https://mavlink.io/en/messages/common.html. pymavlink packs and parses them.
"""

from __future__ import annotations

import functools
import importlib
import struct
from typing import Any

import numpy as np

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, reported_variance
from quad_mpc_ros.ros.bridges.frames import (
    enu_from_ned,
    flu_from_frd,
    q_enu_flu_xyzw_from_ned_frd_wxyz,
)

AUTOPILOT_COMPONENT, GROUND_STATION, ONBOARD_COMPUTER = 1, 190, 191
IGNORE_ATTITUDE = 128  # and no bit of a rate or of the thrust
ODOMETRY, ATTITUDE_QUATERNION, LOCAL_POSITION_NED, ATTITUDE_TARGET = 331, 31, 32, 83
HEARTBEAT, SYS_STATUS, EXTENDED_SYS_STATE, CURRENT_MODE = 0, 1, 245, 436
DO_SET_MODE, COMPONENT_ARM_DISARM = 176, 400
SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 511, 512

_LOCAL_NED, _LOCAL_FRD, _BODY_FRD = 1, 20, 12
_BODY_FRAMES = (8, _BODY_FRD)  # 8 is the deprecated BODY_NED
_LONGEST_APART_NS = 50_000_000  # between position and attitude of one state
_MICROSECOND, _MILLISECOND = 1_000, 1_000_000
_REAL_32 = 9


@functools.cache
def dialect() -> Any:
    """Return pymavlink's module of common and development messages (CURRENT_MODE)."""
    return importlib.import_module("pymavlink.dialects.v20.development")


class Codec:
    """One end of a connection: parses messages and numbers sent messages."""

    def __init__(self, *, system: int) -> None:
        """Initialise for the system that the onboard computer belongs to."""
        self.system = system
        self._mavlink = dialect().MAVLink(None, system, ONBOARD_COMPUTER)
        self._mavlink.robust_parsing = True

    def read(self, data: bytes) -> list[Any]:
        """Return the complete messages in received bytes; drop other bytes."""
        found = self._mavlink.parse_buffer(data) if data else None
        known = dialect().mavlink_map
        return [message for message in found or () if message.get_msgId() in known]

    def packed(self, message: Any) -> bytes:
        """Return the bytes of a message; a ground station's heartbeat has another component."""
        is_station = getattr(message, "type", None) == dialect().MAV_TYPE_GCS
        self._mavlink.srcComponent = GROUND_STATION if is_station else ONBOARD_COMPUTER
        return bytes(message.pack(self._mavlink))


def odometry_from_odometry(message: Any) -> OdometrySample:
    """Return the odometry in an ``ODOMETRY``, stamped with the vehicle's clock.

    Raises ``ValueError`` for an unknown frame or an invalid attitude.
    """
    if message.frame_id not in (_LOCAL_NED, _LOCAL_FRD):
        raise ValueError(f"frame_id {message.frame_id}, expected 1 (NED) or 20 (FRD)")
    q_WB_xyzw = q_enu_flu_xyzw_from_ned_frd_wxyz(message.q)
    velocity = message.vx, message.vy, message.vz
    if message.child_frame_id in _BODY_FRAMES:
        v_WB_B = flu_from_frd(velocity)
    elif message.child_frame_id == message.frame_id:
        v_WB_B = so3.rotation_from_quaternion_xyzw(q_WB_xyzw).T @ enu_from_ned(velocity)
    else:
        raise ValueError(
            f"child_frame_id {message.child_frame_id} with frame_id {message.frame_id}, expected "
            f"12 (body FRD) or {message.frame_id}"
        )
    variances = message.velocity_covariance
    return OdometrySample(
        stamp_ns=_MICROSECOND * int(message.time_usec),
        p_WB=enu_from_ned((message.x, message.y, message.z)),
        q_WB_xyzw=q_WB_xyzw,
        v_WB_B=v_WB_B,
        w_WB_B=flu_from_frd((message.rollspeed, message.pitchspeed, message.yawspeed)),
        v_variance=reported_variance([variances[0], variances[6], variances[11]]),
    )


def odometry_from_position_and_attitude(position: Any, attitude: Any) -> OdometrySample | None:
    """Return the odometry of a ``LOCAL_POSITION_NED`` and an ``ATTITUDE_QUATERNION``.

    Body rates predict the attitude to the stamp of the position [vehicle's clock]. Returns None if
    stamps differ by more than 50 ms. Raises ``ValueError`` for an invalid attitude.
    """
    stamp_ns = _MILLISECOND * int(position.time_boot_ms)
    apart_ns = stamp_ns - _MILLISECOND * int(attitude.time_boot_ms)
    if abs(apart_ns) > _LONGEST_APART_NS:
        return None
    q_wxyz = attitude.q1, attitude.q2, attitude.q3, attitude.q4
    w_WB_B = flu_from_frd((attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed))
    if not np.all(np.isfinite(w_WB_B)):
        raise ValueError(f"body rates {w_WB_B.tolist()}")
    R_WB = so3.rotation_from_quaternion_xyzw(q_enu_flu_xyzw_from_ned_frd_wxyz(q_wxyz))
    R_WB = R_WB @ so3.exp(1e-9 * apart_ns * w_WB_B)
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=enu_from_ned((position.x, position.y, position.z)),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
        v_WB_B=R_WB.T @ enu_from_ned((position.vx, position.vy, position.vz)),
        w_WB_B=w_WB_B,
    )


def parameter_of(message: Any, *, by_bytes: bool) -> tuple[str, float]:
    """Return name and value of a ``PARAM_VALUE``.

    An integer is encoded as a number (ArduPilot), or ``by_bytes`` as the bytes of a float (PX4).
    """
    name, value = text_of(message.param_id), float(message.param_value)
    if by_bytes and int(message.param_type) != _REAL_32:
        (value,) = struct.unpack("<i", struct.pack("<f", value))
    return name, float(value)


def text_of(text: str | bytes) -> str:
    """Return a text field without padding."""
    if isinstance(text, bytes):
        text = text.decode("ascii", errors="replace")
    return text.split("\0")[0]


def attitude_target(
    command: CommandSample, *, throttle: float, now_ns: int, system: int, component: int
) -> Any:
    """Return a ``SET_ATTITUDE_TARGET`` with body rates [rad/s, FRD] and throttle [0, 1] only."""
    return dialect().MAVLink_set_attitude_target_message(
        now_ns // _MILLISECOND % 2**32,
        system,
        component,
        IGNORE_ATTITUDE,
        [1.0, 0.0, 0.0, 0.0],
        *flu_from_frd(command.w_WB_B).tolist(),
        throttle,
    )


def command_long(command: int, *parameters: float, system: int, component: int) -> Any:
    """Return a ``COMMAND_LONG`` with up to seven parameters."""
    seven = [*parameters, *(7 - len(parameters)) * [0.0]]
    return dialect().MAVLink_command_long_message(system, component, command, 0, *seven)


def heartbeat(*, ground_station: bool = False) -> Any:
    """Return the ``HEARTBEAT`` of an active onboard computer, or of a ground station."""
    mavlink = dialect()
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS if ground_station else mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavlink.MAV_STATE_ACTIVE,
        3,
    )


def timesync(*, sent_ns: int) -> Any:
    """Return a request for the vehicle's time."""
    return dialect().MAVLink_timesync_message(0, sent_ns)
