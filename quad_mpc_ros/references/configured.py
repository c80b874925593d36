# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories from a configuration, checked against the vehicle's limits, or from a message."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.safety.validation import pose_fault
from quad_mpc_ros.references import point_table
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.feasibility import Feasibility, judged
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.flatness import yaw_of
from quad_mpc_ros.references.minimum_snap import snap_spline
from quad_mpc_ros.references.path import Path, Slowed, SplinePath
from quad_mpc_ros.references.trajectory import Trajectory

# Search for the time scaling: growth of the factor, largest factor, and precision.
_GROWTH, _LARGEST_FACTOR, _PRECISION = 1.2, 50.0, 1.005
# Limits of received trajectories, so that their preparation does not delay windows.
_MOST_POINTS, _LONGEST = 1000, 600.0  # s


def configured_trajectory(config: ReferenceConfig) -> Trajectory:
    """Return the configured trajectory, slowed down with ``time_scaling`` ``auto``.

    Raises :class:`UserError` for invalid input, and for a smooth trajectory that the vehicle
    cannot fly, with the worst excess and its time. A trajectory with jumps is never feasible but
    accepted: such trajectories test controllers.
    """
    return _approved(*judged_trajectory(config), config)


def joined_trajectory(config: ReferenceConfig) -> Trajectory:
    """Return the trajectory with minimum-snap legs instead of jumps.

    Raises like :func:`configured_trajectory`.
    """
    joined = config.entry().joined
    if joined is None:
        return configured_trajectory(config)
    return _approved(*_judged(joined(config), config), config)


def judged_trajectory(config: ReferenceConfig) -> tuple[Trajectory, Feasibility]:
    """Return the configured trajectory and its feasibility, even if infeasible."""
    return _judged(config.entry().make(config), config)


def _judged(made: Path | Trajectory, config: ReferenceConfig) -> tuple[Trajectory, Feasibility]:
    if isinstance(made, Trajectory):
        return made, judged(made, config)
    if config.time_scaling == "auto" and config.entry().scalable:
        return _quickest(made, config) or _flown(made, config)
    return _flown(made, config)


def _quickest(path: Path, config: ReferenceConfig) -> tuple[Trajectory, Feasibility] | None:
    """Return the feasible trajectory with the smallest time scaling, or None.

    The factor is searched from 1 upwards, then by bisection.
    """
    factor, found = 1.0, _feasible(Slowed(path, 1.0), config)
    while found is None:
        factor *= _GROWTH
        if factor > _LARGEST_FACTOR:
            return None
        found = _feasible(Slowed(path, factor), config)
    slow, quick = factor, factor / _GROWTH
    while factor > 1.0 and slow > _PRECISION * quick:
        middle = math.sqrt(slow * quick)
        better = _feasible(Slowed(path, middle), config)
        if better is None:
            quick = middle
        else:
            slow, found = middle, better
    return found


def _feasible(path: Path, config: ReferenceConfig) -> tuple[Trajectory, Feasibility] | None:
    try:
        trajectory, verdict = _flown(path, config)
    except ConfigurationError:  # free fall
        return None
    return (trajectory, verdict) if verdict.feasible else None


def _flown(path: Path, config: ReferenceConfig) -> tuple[Trajectory, Feasibility]:
    try:
        trajectory = FlatTrajectory(path, config, yaw=config.yaw)
    except ValueError as error:
        raise _refusal(config, str(error)) from error
    return trajectory, judged(trajectory, config)


def _approved(trajectory: Trajectory, verdict: Feasibility, config: ReferenceConfig) -> Trajectory:
    if trajectory.smooth and not verdict.feasible:
        raise _refusal(config, verdict.reason())
    return trajectory


def _refusal(config: ReferenceConfig, reason: str) -> ConfigurationError:
    """Return the error for a trajectory that the vehicle cannot fly, with advice."""
    if not config.entry().scalable:
        advice = f"change the parameters of {config.trajectory}"
    elif config.time_scaling == "none":
        advice = "slow it down, or set time_scaling to auto"
    else:
        advice = "slowing down does not help"
    return ConfigurationError(
        f"{config.owner}.trajectory",
        config.trajectory,
        f"a trajectory within the vehicle's limits: {reason}; {advice}",
    )


def received_trajectory(window: ReferenceWindow, config: ReferenceConfig) -> FlatTrajectory:
    """Return the trajectory through the points of a message, at their times, from rest to rest.

    Positions and yaw are used; everything else follows from flatness. Few points are joined by a
    minimum-snap path, more points are smoothed like a table. Raises :class:`UserError` or
    ``ValueError`` for unusable points.
    """
    count = len(window.offset_ns)
    if not 2 <= count <= _MOST_POINTS:
        raise UserError(f"the trajectory has {count} points, expected 2 to {_MOST_POINTS}")
    fault = pose_fault(
        frame_id=window.frame_id,
        expected_frame_id=config.frame_id,
        p_WB=window.p_WB,
        q_WB_xyzw=window.q_WB_xyzw,
    )
    if fault is not None:
        raise UserError(fault)
    seconds = np.asarray(1e-9 * window.offset_ns, dtype=np.float64)
    point_table.check_increasing(seconds)
    if seconds[-1] - seconds[0] > _LONGEST:
        raise UserError(f"duration {seconds[-1] - seconds[0]:g} s, expected at most {_LONGEST:g}")
    R_WB = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw)
    yaw = np.unwrap([yaw_of(R) for R in R_WB])
    return FlatTrajectory(_through(seconds - seconds[0], window.p_WB, yaw, config), config)


def _through(seconds: Array, p_WB: Array, yaw: Array, config: ReferenceConfig) -> Path:
    if len(seconds) < point_table.LEAST_POINTS:
        spline = snap_spline(np.column_stack((p_WB, yaw)), seconds)
        return SplinePath(spline, duration=float(seconds[-1]))
    table = point_table.PointTable(source="the message", seconds=seconds, p_WB=p_WB, yaw=yaw)
    return point_table.table_path(table, dataclasses.replace(config, origin=(0.0, 0.0)))
