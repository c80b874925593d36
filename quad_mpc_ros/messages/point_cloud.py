"""``sensor_msgs/PointCloud2`` from a message and to its bytes, without a loop over points."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.messages.conversions import nanoseconds

_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_AXES = ("x", "y", "z")
_MAX_POINT_SIZE = 1 << 20  # bytes


@dataclass(frozen=True, kw_only=True, eq=False)
class PointCloud:
    """The n finite points of a cloud: ``p_SQ`` (n, 3) [m] in the frame S of its header.

    ``given`` is how many there were with those that are not finite.
    """

    stamp_ns: int
    frame_id: str
    p_SQ: NDArray[np.floating[Any]]
    given: int


def point_cloud_from_message(message: Any) -> PointCloud:
    """Return the points of a ``sensor_msgs/PointCloud2``.

    A cloud without points is one that saw nothing. Coordinates may be of any type that the message
    knows, in any order and at any offset, with anything beside them, and rows may be longer than
    their points.

    Raises:
        ValueError: It has no x, y and z, or no finite point.
    """
    stamp_ns, frame_id, points = records_from_message(message, _AXES)
    count = points.size
    if count == 0:
        nothing = np.zeros((0, 3), np.float32)
        return PointCloud(stamp_ns=stamp_ns, frame_id=frame_id, p_SQ=nothing, given=0)
    p_SQ = _near_points(points)
    if len(p_SQ) == 0:
        raise ValueError(
            f"a cloud of {count} points of which none is finite and within {FARTHEST:g} m"
        )
    return PointCloud(stamp_ns=stamp_ns, frame_id=frame_id, p_SQ=p_SQ, given=count)


def written_point_cloud(cloud: PointCloud) -> bytes:
    """Return a cloud as a ``sensor_msgs/PointCloud2`` of x, y and z as 32-bit floats."""
    points = np.zeros(len(cloud.p_SQ), [(axis, "<f4") for axis in _AXES])
    for axis, column in zip(_AXES, cloud.p_SQ.T, strict=True):
        points[axis] = column
    return written_records(points, stamp_ns=cloud.stamp_ns, frame_id=cloud.frame_id)


def records_from_message(message: Any, names: Sequence[str]) -> tuple[int, str, NDArray[Any]]:
    """Return stamp [ns], frame and the named fields (h, w) of a ``sensor_msgs/PointCloud2``.

    Raises ``ValueError`` where a field is not in it, or its size is not that of its data.
    """
    stamp_ns, frame_id = nanoseconds(message.header.stamp), message.header.frame_id
    height, width, point_step = message.height, message.width, message.point_step
    if height * width == 0:
        return stamp_ns, frame_id, np.zeros((0, 0))
    found = {field.name: (field.offset, field.datatype) for field in message.fields}
    dtype = _dtype_of(found, names, ">" if message.is_bigendian else "<", point_step)
    rows = message.row_step if height > 1 else width * point_step
    needed = (height - 1) * rows + width * point_step
    if rows < width * point_step or needed > len(message.data):
        raise ValueError(
            f"a cloud of {height} rows of {width} points of {point_step} bytes in rows of "
            f"{message.row_step}, with {len(message.data)} bytes of data"
        )
    points = np.ndarray((height, width), dtype, message.data, strides=(rows, point_step))
    return stamp_ns, frame_id, points


def written_records(records: NDArray[Any], *, stamp_ns: int, frame_id: str) -> bytes:
    """Return a structured array (n,) of little-endian numbers as a ``sensor_msgs/PointCloud2``."""
    fields: Mapping[str, Any] = records.dtype.fields or {}
    size = records.dtype.itemsize
    kinds = {kind: number for number, kind in _FIELD_TYPES.items()}
    parts = [struct.pack("<iI", *divmod(stamp_ns, 1_000_000_000)), _text(frame_id)]
    parts.append(struct.pack("<III", 1, len(records), len(fields)))
    for name, (dtype, offset, *_) in fields.items():
        parts += [_text(name), struct.pack("<IBxxxI", offset, kinds[dtype.str[1:]], 1)]
    octets = records.tobytes()
    parts.append(struct.pack("<BxxxIII", 0, size, len(octets), len(octets)))
    return b"\x00\x01\x00\x00" + b"".join([*parts, octets, b"\x01"])


def _text(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + b"\0" * (-len(data) % 4)


def _dtype_of(
    found: dict[str, tuple[int, int]], names: Sequence[str], order: str, point_step: int
) -> np.dtype[Any]:
    """Return the type of a point, of which only some fields are looked at."""
    missing = [name for name in names if name not in found]
    if missing:
        raise ValueError(f"a cloud without {', '.join(missing)}; it has {', '.join(found)}")
    formats, offsets = [], []
    for name in names:
        offset, kind = found[name]
        if kind not in _FIELD_TYPES:
            raise ValueError(f"a cloud whose {name} is of type {kind}, expected 1 to 8")
        formats.append(np.dtype(f"{order}{_FIELD_TYPES[kind]}"))
        offsets.append(offset)
        if offset + formats[-1].itemsize > point_step:
            raise ValueError(f"a cloud whose {name} ends behind its {point_step} bytes a point")
    if max(offsets) > _MAX_POINT_SIZE:
        raise ValueError(f"a cloud of {point_step} bytes a point")
    size = max(o + f.itemsize for o, f in zip(offsets, formats, strict=True))
    return np.dtype(
        {"names": list(names), "formats": formats, "offsets": offsets, "itemsize": size}
    )


def _near_points(points: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """Return those of coordinates (h, w) that can have been measured as points (n, 3).

    They are 64-bit only if one of the coordinates was.
    """
    wide = any(points.dtype[axis].itemsize == 8 for axis in _AXES)
    # Coordinate by coordinate: on points one after another it takes three times as long.
    columns = np.empty((len(_AXES), points.size), np.float64 if wide else np.float32)
    for column, axis in zip(columns, _AXES, strict=True):
        column.reshape(points.shape)[...] = points[axis]
    near = np.ones(points.size, dtype=bool)
    for column in columns:
        near &= np.abs(column) <= FARTHEST  # NaN compares with nothing
    return columns.T if near.all() else columns[:, near].T
