# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Packets of the Crazy RealTime Protocol of the Crazyflie, over radio, USB and UDP.

A packet is a byte with port and channel, and up to 30 bytes of data, little endian. Positions and
attitudes are in ENU and FLU, body rates in rad/s. Only the legacy setpoint uses degrees, pitch
nose-up and yaw clockwise. In a byte stream each packet follows its length.

Numbers and layouts after the firmware, https://github.com/bitcraze/crazyflie-firmware
(src/modules/src/crtp_*.c, log.c, param_task.c, platformservice.c, supervisor.c).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from quad_mpc_ros.control.lie import Array

PWM_FULL = 65535.0
PWM_LARGEST = 60000  # limit of the legacy setpoint

# Bits of the log variable supervisor.info.
IS_ARMED, ARMS_ITSELF = 2, 4
IS_FLYING = 16
IS_TUMBLED = 32
IS_LOCKED = 64

PARAMETERS, SETPOINT, LOG, LOCALIZATION, SETPOINT_GENERIC, HIGH_LEVEL, PLATFORM = (
    *(2, 3, 5, 6, 7, 8),
    13,
)
_LOG_CONTENTS, _LOG_CONTROL, _LOG_DATA = range(3)
_LOCALIZATION_POSITION, _LOCALIZATION_OTHER = range(2)
_SETPOINT_META, _PARAMETERS_OTHER, _PLATFORM_COMMAND = 1, 3, 0
_GET_ITEM, _GET_INFO = 2, 3
_START_BLOCK, _RESET, _CREATE_BLOCK = 3, 5, 6
_EXTERNAL_POSE = 8
_GO_TO, _LAND = 4, 8
_ARM_COMMAND = 1
_UINT8_TYPE = 8  # type of a parameter of one byte

_MAX_DATA_SIZE = 30
_RESERVED_BITS = 0x0C  # set in all sent packets
# Format of a log variable by its type, from 1 on; the last one is a half-precision float.
_LOG_TYPE_FORMATS = ("B", "H", "I", "b", "h", "i", "f", "e")


def is_armed(info: int, *, wanted: bool) -> bool:
    """Return whether supervisor.info reports armed.

    A vehicle with automatic arming arms again at once. So if disarming is requested, the flying
    bit is used instead.
    """
    return bool(info & (IS_FLYING if info & ARMS_ITSELF and not wanted else IS_ARMED))


@dataclass(frozen=True, kw_only=True)
class Packet:
    """A packet."""

    port: int
    channel: int
    data: bytes = b""

    def __post_init__(self) -> None:
        """Raise ``ValueError`` for too much data."""
        if len(self.data) > _MAX_DATA_SIZE:
            raise ValueError(f"a packet has {len(self.data)} bytes of data, expected 30 or less")

    @property
    def header(self) -> int:
        """The first byte."""
        return self.port << 4 | _RESERVED_BITS | self.channel

    def rest(self, port: int, channel: int, head: bytes) -> bytes | None:
        """Return the data after ``head``; None for a packet of another kind."""
        fits = (self.port, self.channel) == (port, channel) and self.data.startswith(head)
        return self.data[len(head) :] if fits else None

    def framed(self) -> bytes:
        """Return the packet as in a stream: length, header, data."""
        return bytes((1 + len(self.data), self.header)) + self.data


@dataclass(frozen=True, kw_only=True)
class LogVariable:
    """A log variable with its type ``kind``, and a ``name`` like ``pm.vbat``."""

    number: int
    kind: int
    name: str


class PacketReader:
    """Splits a stream into packets."""

    def __init__(self) -> None:
        self._held = b""

    def read(self, data: bytes) -> Iterator[Packet]:
        """Receive bytes; yield all complete packets."""
        self._held += data
        while self._held and len(self._held) > self._held[0]:
            size = self._held[0]
            whole, self._held = self._held[1 : 1 + size], self._held[1 + size :]
            if 1 <= size <= 1 + _MAX_DATA_SIZE:
                yield Packet(port=whole[0] >> 4, channel=whole[0] & 3, data=whole[1:])


def rate_setpoint(*, roll: float, pitch: float, heading: float, throttle: float) -> Packet:
    """Return the legacy setpoint: rates about body x and y (FLU), heading rate and throttle.

    Rates are in rad/s, the heading rate counter-clockwise, the throttle in [0, 1]. The setpoint
    contains rates only if ``flightmode.stabModeRoll``, ``Pitch`` and ``Yaw`` are 0. A setpoint of
    zeros unlocks the thrust.
    """
    degrees = math.degrees(roll), -math.degrees(pitch), -math.degrees(heading)
    pwm = min(round(throttle * PWM_FULL), PWM_LARGEST)
    return Packet(port=SETPOINT, channel=0, data=struct.pack("<fffH", *degrees, pwm))


def external_pose(p_WB: Array, q_WB_xyzw: Array) -> Packet:
    """Return a measured pose (3,) [m], (4,) for the onboard estimator."""
    data = struct.pack("<B7f", _EXTERNAL_POSE, *p_WB.tolist(), *q_WB_xyzw.tolist())
    return Packet(port=LOCALIZATION, channel=_LOCALIZATION_OTHER, data=data)


def external_position(p_WB: Array) -> Packet:
    """Return a measured position (3,) [m] for the onboard estimator."""
    data = struct.pack("<3f", *p_WB.tolist())
    return Packet(port=LOCALIZATION, channel=_LOCALIZATION_POSITION, data=data)


def stop_setpoints(*, remain_valid: float) -> Packet:
    """Return the end of setpoints; the last setpoint is valid for a time [s] or until replaced."""
    data = struct.pack("<BI", 0, round(1e3 * remain_valid))
    return Packet(port=SETPOINT_GENERIC, channel=_SETPOINT_META, data=data)


def stay(*, duration: float) -> Packet:
    """Return the request to the firmware to hold position and heading."""
    data = struct.pack("<BBB5f", _GO_TO, 0, True, 0.0, 0.0, 0.0, 0.0, duration)
    return Packet(port=HIGH_LEVEL, channel=0, data=data)


def land(*, height: float, duration: float) -> Packet:
    """Return the request to the firmware to land at a height [m, world] within a duration [s]."""
    data = struct.pack("<BBff?f", _LAND, 0, height, 0.0, True, duration)
    return Packet(port=HIGH_LEVEL, channel=0, data=data)


def arm(wanted: bool) -> Packet:
    """Return the request to arm or disarm."""
    return Packet(port=PLATFORM, channel=_PLATFORM_COMMAND, data=bytes((_ARM_COMMAND, wanted)))


def set_parameter(name: str, value: int) -> Packet:
    """Return the request to set a parameter of one byte, named like ``flightmode.althold``."""
    data = bytes((0, *_text(name), _UINT8_TYPE, value))
    return Packet(port=PARAMETERS, channel=_PARAMETERS_OTHER, data=data)


def parameter_answer(packet: Packet, name: str) -> int | None:
    """Return the error number in the answer to setting a parameter, 0 for success."""
    rest = packet.rest(PARAMETERS, _PARAMETERS_OTHER, bytes((0, *_text(name))))
    return rest[0] if rest else None


def log_reset() -> Packet:
    """Return the request to remove all log blocks."""
    return Packet(port=LOG, channel=_LOG_CONTROL, data=bytes((_RESET,)))


def log_count_request() -> Packet:
    """Return the request for the number of log variables."""
    return Packet(port=LOG, channel=_LOG_CONTENTS, data=bytes((_GET_INFO,)))


def log_count(packet: Packet) -> int | None:
    """Return the number of log variables, if the packet contains it."""
    rest = packet.rest(LOG, _LOG_CONTENTS, bytes((_GET_INFO,)))
    return None if rest is None or len(rest) < 2 else int.from_bytes(rest[:2], "little")


def log_variable_request(number: int) -> Packet:
    """Return the request for the name of a log variable."""
    return Packet(port=LOG, channel=_LOG_CONTENTS, data=struct.pack("<BH", _GET_ITEM, number))


def log_variable(packet: Packet) -> LogVariable | None:
    """Return the log variable in a packet, if any."""
    data = packet.rest(LOG, _LOG_CONTENTS, bytes((_GET_ITEM,))) or b""
    names = data[3:].split(b"\0")
    if len(names) < 3:  # each ends with a zero
        return None
    number = int.from_bytes(data[:2], "little")
    name = ".".join(part.decode("ascii", "replace") for part in names[:2])
    return LogVariable(number=number, kind=data[2] & 0xF, name=name)


def log_block(block: int, variables: Sequence[LogVariable]) -> Packet:
    """Return the request to create a log block of variables."""
    asked = b"".join(struct.pack("<BH", each.kind, each.number) for each in variables)
    return Packet(port=LOG, channel=_LOG_CONTROL, data=bytes((_CREATE_BLOCK, block)) + asked)


def log_start(block: int, *, period: float) -> Packet:
    """Return the request to send a log block with a period [s], a multiple of 10 ms."""
    data = bytes((_START_BLOCK, block, round(1e2 * period)))
    return Packet(port=LOG, channel=_LOG_CONTROL, data=data)


def logged(
    packet: Packet, block: int, variables: Sequence[LogVariable]
) -> dict[str, float] | None:
    """Return the values of a log block by name, if the packet contains them."""
    data = packet.rest(LOG, _LOG_DATA, bytes((block,)))
    if data is None or any(not 1 <= each.kind <= len(_LOG_TYPE_FORMATS) for each in variables):
        return None
    layout = "<" + "".join(_LOG_TYPE_FORMATS[each.kind - 1] for each in variables)
    values = data[3:]  # after a time in three bytes
    if len(values) != struct.calcsize(layout):
        return None
    names = [each.name for each in variables]
    return dict(zip(names, map(float, struct.unpack(layout, values)), strict=True))


def _text(name: str) -> bytes:
    return b"".join(part.encode("ascii") + b"\0" for part in name.split("."))
