"""The active corridor as a ``sensor_msgs/PointCloud2`` whose points are half-spaces.

A point is a half-space n' p <= b on the position at the end of a stage, with the fields ``stage``,
the unit vector ``normal_x``, ``normal_y``, ``normal_z``, and ``offset`` b [m], in the frame of the
header; the stamp is that of the constrained plan. Without points the space is free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.messages.cdr import written_records
from quad_mpc_ros.messages.point_cloud import records_from_message

_NORMAL = ("normal_x", "normal_y", "normal_z")
_RECORD = np.dtype([("stage", "<u4"), *((name, "<f4") for name in _NORMAL), ("offset", "<f8")])


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfSpaces:
    """Half-spaces n' p <= b: ``stage`` (n,) from 0, ``normals`` (n, 3), ``offsets`` (n,) [m]."""

    stage: NDArray[np.int64]
    normals: Array
    offsets: Array

    def of_stage(self, stage: int) -> tuple[Array, Array]:
        """Return the normals (k, 3) and offsets (k,) [m] of a stage."""
        own = self.stage == stage
        return self.normals[own], self.offsets[own]


def written_corridor(corridor: Corridor | None, *, stamp_ns: int, frame_id: str) -> bytes:
    """Return the active rows of a corridor, with the stamp of a plan."""
    if corridor is None:
        return written_records(np.zeros(0, _RECORD), stamp_ns=stamp_ns, frame_id=frame_id)
    stage, row = np.nonzero(np.isfinite(corridor.offsets))
    records = np.zeros(len(stage), _RECORD)
    records["stage"], records["offset"] = stage, corridor.offsets[stage, row]
    for axis, name in enumerate(_NORMAL):
        records[name] = corridor.normals[stage, row, axis]
    return written_records(records, stamp_ns=stamp_ns, frame_id=frame_id)


def corridor_from_message(message: Any) -> HalfSpaces:
    """Return the half-spaces of a message; ``ValueError`` for other point types."""
    records = records_from_message(message, _RECORD.names or ())
    rows = records.ravel() if records.dtype.names else np.zeros(0, _RECORD)
    return HalfSpaces(
        stage=rows["stage"].astype(np.int64),
        normals=np.column_stack([rows[name] for name in _NORMAL]).astype(np.float64),
        offsets=rows["offset"].astype(np.float64),
    )
