# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of messages read or written at every tick, without an object for each field.

CDR as used by DDS (OMG DDSI-RTPS, 10.2; XCDR version 1): four bytes with the byte order, then the
fields in order, numbers aligned to their size, texts with length and terminating zero.

A reader returns None for unsupported bytes, valid or not: big-endian bytes, a text without its
end, a trajectory point with two transforms. Then rclpy must decode the message. A writer fills
gaps with zeros, whereas rclpy leaves the previous content of the memory.
"""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
    reported_variance,
)

_SECOND = 1_000_000_000
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # encapsulation; alignment counts from its end
_START = len(_LITTLE_ENDIAN)
_MAX_NAMES = 64

_ODOMETRY_VALUES = 7 + 36 + 6 + 36  # pose and twist, each with its covariance
_TWIST_START = 7 + 36
_VARIANCES = (_TWIST_START + 6, _TWIST_START + 6 + 7, _TWIST_START + 6 + 14)

_IMU_VALUES = 4 + 9 + 3 + 9 + 3 + 9  # orientation, rates, acceleration, each with covariance
_ORIENTATION_COVARIANCE, _RATES_COVARIANCE = 4, 4 + 9 + 3  # where the covariances begin
_ACCELERATION_START, _ACCELERATION_COVARIANCE = 4 + 9 + 3 + 9, 4 + 9 + 3 + 9 + 3
NOT_MEASURED = -1.0
"""The first covariance entry of a quantity that an IMU does not measure (REP 145)."""

POINT_FIELD_TYPES = ("", "i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""The types of fields of a ``sensor_msgs/PointCloud2`` by their numbers, from 1."""

_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
# A point, from its transform on to the count of the next point's transforms.
_POINT = np.dtype(
    [
        ("p", "<f8", 3),
        ("q", "<f8", 4),
        ("velocities", "<u4"),
        ("v", "<f8", 3),
        ("w", "<f8", 3),
        ("accelerations", "<u4"),
        ("a", "<f8", 3),
        ("angular_acceleration", "<f8", 3),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("transforms_of_next", "<u4"),
    ],
    align=True,
)
_LAST_POINT_GAP = 8  # the last point has no transforms of a next one


class _UnknownError(Exception):
    """The bytes are left to rclpy."""


def read_odometry(data: bytes) -> OdometrySample | None:
    """Return a ``nav_msgs/Odometry``, or None if rclpy must decode it."""
    try:
        stamp_ns, frame_id, at = _first_header(data)
        child_frame_id, at = _text(data, at)
    except (_UnknownError, struct.error):
        return None
    at = _aligned(at, 8)
    if len(data) < at + 8 * _ODOMETRY_VALUES:
        return None
    numbers = np.frombuffer(data, "<f8", _ODOMETRY_VALUES, at).astype(np.float64)
    return OdometrySample(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        p_WB=numbers[0:3],
        q_WB_xyzw=numbers[3:7],
        v_WB_B=numbers[_TWIST_START : _TWIST_START + 3],
        w_WB_B=numbers[_TWIST_START + 3 : _TWIST_START + 6],
        v_variance=reported_variance([float(numbers[place]) for place in _VARIANCES]),
    )


def read_reference(data: bytes) -> ReferenceWindow | None:
    """Return a ``trajectory_msgs/MultiDOFJointTrajectory``, or None if rclpy must decode it.

    Every point must have one transform, one velocity and one acceleration.
    """
    try:
        stamp_ns, frame_id, at = _first_header(data)
        names, at = _number(data, at)
        if names > _MAX_NAMES:
            return None
        for _ in range(names):
            _, at = _text(data, at)
        count, at = _number(data, at)
        transforms, at = _number(data, at)
    except (_UnknownError, struct.error):
        return None
    at = _aligned(at, 8)
    size = count * _POINT.itemsize
    if count == 0 or transforms != 1 or len(data) < at + size - _LAST_POINT_GAP:
        return None
    points = np.frombuffer(data[at : at + size].ljust(size, b"\0"), _POINT)
    if not (
        (points["velocities"] == 1).all()
        and (points["accelerations"] == 1).all()
        and (points["transforms_of_next"][:-1] == 1).all()
    ):
        return None
    offset_ns = points["sec"].astype(np.int64) * _SECOND + points["nanosec"]
    p, q, v, w, a = (points[name].astype(np.float64) for name in ("p", "q", "v", "w", "a"))
    return ReferenceWindow(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        offset_ns=offset_ns,
        p_WB=p,
        q_WB_xyzw=q,
        v_WB_W=v,
        a_WB_W=a,
        w_WB_W=w,
    )


def written_odometry(odometry: OdometrySample) -> bytes:
    """Return a ``nav_msgs/Odometry``."""
    numbers = np.zeros(_ODOMETRY_VALUES, "<f8")
    numbers[0:3], numbers[3:7] = odometry.p_WB, odometry.q_WB_xyzw
    numbers[_TWIST_START : _TWIST_START + 3] = odometry.v_WB_B
    numbers[_TWIST_START + 3 : _TWIST_START + 6] = odometry.w_WB_B
    for place in _VARIANCES:
        numbers[place] = odometry.v_variance
    texts = _padded(_chunk(odometry.frame_id) + _chunk(odometry.child_frame_id), after=8)
    return _LITTLE_ENDIAN + _stamp(odometry.stamp_ns) + texts + numbers.tobytes()


def written_imu(sample: ImuSample) -> bytes:
    """Return a ``sensor_msgs/Imu`` without orientation and body rates."""
    numbers = np.zeros(_IMU_VALUES, "<f8")
    numbers[_ORIENTATION_COVARIANCE] = numbers[_RATES_COVARIANCE] = NOT_MEASURED
    numbers[_ACCELERATION_START:_ACCELERATION_COVARIANCE] = sample.f_B
    texts = _padded(_chunk(sample.frame_id), after=8)
    return _LITTLE_ENDIAN + _stamp(sample.stamp_ns) + texts + numbers.tobytes()


def written_command(command: CommandSample) -> bytes:
    """Return a ``geometry_msgs/TwistStamped``: throttle in linear.z."""
    numbers = struct.pack("<6d", 0.0, 0.0, command.throttle, *command.w_WB_B.tolist())
    texts = _padded(_chunk(command.frame_id), after=8)
    return _LITTLE_ENDIAN + _stamp(command.stamp_ns) + texts + numbers


def written_reference(window: ReferenceWindow, *, child_frame_id: str) -> bytes:
    """Return a ``trajectory_msgs/MultiDOFJointTrajectory`` of one joint."""
    count = len(window.p_WB)
    points = np.zeros(count, _POINT)
    points["p"], points["q"] = window.p_WB, window.q_WB_xyzw
    points["v"], points["w"], points["a"] = window.v_WB_W, window.w_WB_W, window.a_WB_W
    for name in ("velocities", "accelerations", "transforms_of_next"):
        points[name] = 1
    points["sec"], points["nanosec"] = np.divmod(window.offset_ns, _SECOND)
    beginning = (
        _stamp(window.stamp_ns)
        + _chunk(window.frame_id)
        + struct.pack("<I", 1)
        + _chunk(child_frame_id)
        + struct.pack("<I", count)
    )
    if not count:
        return _LITTLE_ENDIAN + beginning
    beginning = _padded(beginning + struct.pack("<I", 1), after=0)
    return _LITTLE_ENDIAN + beginning + points.tobytes()[:-_LAST_POINT_GAP]


def written_path(
    *, stamp_ns: int, step_ns: int, frame_id: str, p_WB: Array, q_WB_xyzw: Array
) -> bytes:
    """Return a ``nav_msgs/Path`` of positions (n, 3) and quaternions (n, 4), a step apart."""
    frame = _chunk(frame_id)
    data = bytearray(_stamp(stamp_ns) + frame + struct.pack("<I", len(p_WB)))
    poses = np.concatenate((p_WB, q_WB_xyzw), axis=1, dtype="<f8")
    for i, pose in enumerate(poses):
        data += _stamp(stamp_ns + i * step_ns) + frame
        data += b"\0" * (-len(data) % 8) + pose.tobytes()
    return _LITTLE_ENDIAN + bytes(data)


def written_diagnostics(
    *,
    stamp_ns: int,
    level: bytes,
    name: str,
    text: str,
    values: Sequence[tuple[str, str]],
    hardware_id: str = "",
) -> bytes:
    """Return a ``diagnostic_msgs/DiagnosticArray`` of one status; ``level`` is one byte."""
    parts = [
        _LITTLE_ENDIAN,
        _stamp(stamp_ns),
        _chunk(""),
        struct.pack("<I", 1),
        level,
        b"\0\0\0",
        _chunk(name),
        _fresh_chunk(text),
        _chunk(hardware_id),
        struct.pack("<I", len(values)),
    ]
    for key, value in values:
        parts += _chunk(key), _fresh_chunk(value)
    data = b"".join(parts)
    last = len(values[-1][1].encode()) + 1 if values else 0
    return data[: len(data) - -last % 4]  # no gap where nothing follows


def written_battery(voltage: float, *, stamp_ns: int) -> bytes:
    """Return a ``sensor_msgs/BatteryState`` with a voltage [V]; other fields are unknown."""
    measured = struct.pack("<7f4B2I", voltage, *[math.nan] * 6, 0, 0, 0, True, 0, 0)
    return _LITTLE_ENDIAN + _stamp(stamp_ns) + _chunk("") + measured + _chunk("") + _chunk("")[:-3]


def written_records(records: NDArray[Any], *, stamp_ns: int, frame_id: str) -> bytes:
    """Return a structured array (n,) of little-endian numbers as a ``sensor_msgs/PointCloud2``."""
    fields: Mapping[str, Any] = records.dtype.fields or {}
    size, octets = records.dtype.itemsize, records.tobytes()
    parts = [_LITTLE_ENDIAN, _stamp(stamp_ns), _chunk(frame_id)]
    parts.append(struct.pack("<III", 1, len(records), len(fields)))
    for name, (dtype, offset, *_) in fields.items():
        kind = POINT_FIELD_TYPES.index(dtype.str[1:])
        parts += [_chunk(name), struct.pack("<IBxxxI", offset, kind, 1)]
    parts.append(struct.pack("<BxxxIII", 0, size, len(octets), len(octets)))
    return b"".join([*parts, octets, b"\x01"])


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp [ns] of a message that begins with a ``std_msgs/Header``.

    Raises ``ValueError`` for too few bytes.
    """
    try:
        seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, _START)
    except (IndexError, struct.error) as error:
        raise ValueError(f"no stamp in {len(data)} bytes") from error
    return int(seconds) * _SECOND + int(nanoseconds)


def _first_header(data: bytes) -> tuple[int, str, int]:
    """Return stamp [ns] and frame of a leading header, and the offset of its end."""
    if data[:2] != _LITTLE_ENDIAN[:2]:
        raise _UnknownError
    sec, nanosec = _STAMP.unpack_from(data, _START)
    frame_id, at = _text(data, _START + _STAMP.size)
    return sec * _SECOND + nanosec, frame_id, at


def _number(data: bytes, at: int) -> tuple[int, int]:
    """Return an unsigned number of four bytes, and the offset of its end."""
    at = _aligned(at, 4)
    return _LENGTH.unpack_from(data, at)[0], at + 4


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return a text, and the offset of its end."""
    length, at = _number(data, at)
    end = at + length
    if length == 0 or len(data) < end or data.find(0, at, end) != end - 1:
        raise _UnknownError
    return _decoded(data[at : end - 1]), end


@functools.lru_cache(maxsize=64)
def _decoded(text: bytes) -> str:
    try:
        return text.decode()
    except UnicodeDecodeError:
        raise _UnknownError from None


def _aligned(at: int, size: int) -> int:
    return at + (_START - at) % size


def _stamp(stamp_ns: int) -> bytes:
    return struct.pack("<iI", *divmod(stamp_ns, _SECOND))


_PADDED_ENDS = tuple(b"\0" * (1 + -size % 4) for size in range(4))  # with the gap to what follows


def _fresh_chunk(text: str) -> bytes:
    """Return a text with length, terminator, and the gap to the next number of four bytes."""
    data = text.encode()
    size = len(data) + 1
    return struct.pack("<I", size) + data + _PADDED_ENDS[size % 4]


_chunk = functools.lru_cache(maxsize=256)(_fresh_chunk)


def _padded(data: bytes, *, after: int) -> bytes:
    """Return data, ``after`` bytes from the beginning, with the gap to a number of 8 bytes."""
    return data + b"\0" * (-(after + len(data)) % 8)
