# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading and writing ``sensor_msgs/PointCloud2`` without a loop over points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.messages.cdr import POINT_FIELD_TYPES, written_records
from quad_mpc_ros.messages.conversions import nanoseconds

_AXES = ("x", "y", "z")
_MAX_POINT_SIZE = 1 << 20  # bytes


@dataclass(frozen=True, kw_only=True, eq=False)
class PointCloud:
    """The n finite points of a cloud: ``p_SQ`` (n, 3) [m] in the frame S of its header."""

    stamp_ns: int
    frame_id: str
    p_SQ: NDArray[np.floating[Any]]


def point_cloud_from_message(message: Any) -> PointCloud:
    """Return the points of a ``sensor_msgs/PointCloud2``.

    A cloud without points is valid. Coordinates may have any field type, order and offset, with
    other fields in between, and rows may have padding.

    Raises:
        ValueError: The cloud has no x, y and z, or no finite point.
    """
    points = records_from_message(message, _AXES)
    p_SQ = _near_points(points) if points.size else np.zeros((0, 3), np.float32)
    if points.size and len(p_SQ) == 0:
        raise ValueError(
            f"a cloud of {points.size} points, none of them finite and within {FARTHEST:g} m"
        )
    header = message.header
    return PointCloud(stamp_ns=nanoseconds(header.stamp), frame_id=header.frame_id, p_SQ=p_SQ)


def written_point_cloud(cloud: PointCloud) -> bytes:
    """Return a cloud as a ``sensor_msgs/PointCloud2`` of x, y and z as 32-bit floats."""
    points = np.zeros(len(cloud.p_SQ), [(axis, "<f4") for axis in _AXES])
    for axis, column in zip(_AXES, cloud.p_SQ.T, strict=True):
        points[axis] = column
    return written_records(points, stamp_ns=cloud.stamp_ns, frame_id=cloud.frame_id)


def records_from_message(message: Any, names: Sequence[str]) -> NDArray[Any]:
    """Return the named fields (h, w) of a ``sensor_msgs/PointCloud2``.

    Raises ``ValueError`` for a missing field or a wrong size of the data.
    """
    height, width, point_step = message.height, message.width, message.point_step
    if height * width == 0:
        return np.zeros((0, 0))
    found = {field.name: (field.offset, field.datatype) for field in message.fields}
    dtype = _dtype_of(found, names, ">" if message.is_bigendian else "<", point_step)
    rows = message.row_step if height > 1 else width * point_step
    needed = (height - 1) * rows + width * point_step
    if rows < width * point_step or needed > len(message.data):
        raise ValueError(
            f"a cloud of {height} rows of {width} points of {point_step} bytes in rows of "
            f"{message.row_step}, with {len(message.data)} bytes of data"
        )
    return np.ndarray((height, width), dtype, message.data, strides=(rows, point_step))


def _dtype_of(
    found: dict[str, tuple[int, int]], names: Sequence[str], order: str, point_step: int
) -> np.dtype[Any]:
    """Return the data type of a point, with only some of the fields."""
    missing = [name for name in names if name not in found]
    if missing:
        raise ValueError(f"a cloud without {', '.join(missing)}; it has {', '.join(found)}")
    formats, offsets = [], []
    for name in names:
        offset, kind = found[name]
        if not 0 < kind < len(POINT_FIELD_TYPES):
            raise ValueError(f"a cloud whose {name} is of type {kind}, expected 1 to 8")
        formats.append(np.dtype(f"{order}{POINT_FIELD_TYPES[kind]}"))
        offsets.append(offset)
        if offset + formats[-1].itemsize > point_step:
            raise ValueError(f"a cloud whose {name} ends beyond the {point_step} bytes of a point")
    if max(offsets) > _MAX_POINT_SIZE:
        raise ValueError(f"a cloud with {point_step} bytes per point")
    size = max(o + f.itemsize for o, f in zip(offsets, formats, strict=True))
    return np.dtype(
        {"names": list(names), "formats": formats, "offsets": offsets, "itemsize": size}
    )


def _near_points(points: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """Return the finite coordinates (h, w) that are near enough as points (n, 3).

    Points are 64-bit only if a coordinate of the cloud is.
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
