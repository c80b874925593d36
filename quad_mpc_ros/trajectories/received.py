"""A trajectory out of a received message: checked, and then treated as a table is."""

from __future__ import annotations

import dataclasses

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.safety.validation import pose_fault
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.flat_trajectory import FlatTrajectory
from quad_mpc_ros.trajectories.flatness import yaw_of
from quad_mpc_ros.trajectories.minimum_snap import snap_spline
from quad_mpc_ros.trajectories.path import Path, SplinePath, Turned
from quad_mpc_ros.trajectories.point_table import LEAST_POINTS, PointTable, table_path

# The time to prepare one grows with both, and windows must go on in the meantime.
_MOST_POINTS, _LONGEST = 1000, 600.0  # s


def received_trajectory(window: ReferenceWindow, config: ReferenceConfig) -> FlatTrajectory:
    """Return the trajectory through the points of a message, at their times, from rest to rest.

    Positions and headings count; everything else follows from them by flatness. Few points are
    flown through by the path of least snap, more are smoothed as a table is. Raises
    :class:`UserError` or ``ValueError`` with the reason for what is no trajectory.
    """
    count = len(window.offset_ns)
    if not 2 <= count <= _MOST_POINTS:
        raise UserError(f"it has {count} points, expected 2 to {_MOST_POINTS}")
    fault = pose_fault(
        frame_id=window.frame_id,
        expected_frame_id=config.frame_id,
        p_WB=window.p_WB,
        q_WB_xyzw=window.q_WB_xyzw,
    )
    if fault is not None:
        raise UserError(fault)
    seconds = 1e-9 * window.offset_ns
    for index in np.flatnonzero(np.diff(window.offset_ns) <= 0)[:1]:
        raise UserError(
            f"the time of point {index + 1} (counted from 0), {seconds[index + 1]:g} s, is not "
            f"after that of the point before, {seconds[index]:g} s"
        )
    if seconds[-1] - seconds[0] > _LONGEST:
        raise UserError(f"it takes {seconds[-1] - seconds[0]:g} s, expected at most {_LONGEST:g}")
    R_WB = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw)
    yaw = np.unwrap([yaw_of(R) for R in R_WB])
    path = _through(seconds - seconds[0], window.p_WB, yaw, config)
    return FlatTrajectory(path, gravity=config.gravity, drag=config.drag)


def _through(seconds: Array, p_WB: Array, yaw: Array, config: ReferenceConfig) -> Path:
    if len(seconds) < LEAST_POINTS:
        duration = float(seconds[-1])
        turn = np.column_stack((yaw, np.zeros((len(yaw), 2))))
        return Turned(
            SplinePath(snap_spline(p_WB, seconds), duration=duration),
            SplinePath(snap_spline(turn, seconds), duration=duration),
        )
    table = PointTable(source="the message", seconds=seconds, p_WB=p_WB, yaw=yaw)
    return table_path(table, dataclasses.replace(config, origin=(0.0, 0.0)))
