# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the controllers share: the measured and the desired state, and the command."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow


class TrackingState(NamedTuple):
    """The state and its reference.

    Shapes: ``R_WB`` and ``R_WB_ref`` (3, 3), the others (3,). ``p_error`` [m] and ``v_error``
    [m/s] are measured minus desired, in the world; ``v_WB_W`` is measured, ``v_ref`` and ``a_ref``
    [m/s^2] are desired. ``w_WB_B`` and ``w_ref`` [rad/s] are body rates, each in its own body
    frame.
    """

    R_WB: Array
    R_WB_ref: Array
    p_error: Array
    v_error: Array
    v_WB_W: Array
    v_ref: Array
    a_ref: Array
    w_WB_B: Array
    w_ref: Array

    @property
    def yaw(self) -> float:
        """Heading of the reference, from east to north [rad]."""
        return float(np.arctan2(self.R_WB_ref[1, 0], self.R_WB_ref[0, 0]))


def tracked(odometry: OdometrySample, reference: ReferenceWindow) -> TrackingState:
    """Return the state of an odometry and the reference at the start of the window."""
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    R_WB_ref = so3.rotation_from_quaternion_xyzw(reference.q_WB_xyzw[0])
    v_WB_W = R_WB @ odometry.v_WB_B
    return TrackingState(
        R_WB=R_WB,
        R_WB_ref=R_WB_ref,
        p_error=odometry.p_WB - reference.p_WB[0],
        v_error=v_WB_W - reference.v_WB_W[0],
        v_WB_W=v_WB_W,
        v_ref=reference.v_WB_W[0],
        a_ref=reference.a_WB_W[0],
        w_WB_B=odometry.w_WB_B,
        w_ref=R_WB_ref.T @ reference.w_WB_W[0],
    )


def attitude_of_thrust(direction: Array, *, yaw: float) -> Array:
    """Return the attitude (3, 3) with body z along a direction (3,) and the nose at ``yaw``."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([-np.sin(yaw), np.cos(yaw), 0.0], z)
    x = (x if z[2] >= 0.0 else -x) / np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))


def command(odometry: OdometrySample, *, throttle: float, w_WB_B: Array) -> CommandSample:
    """Return a command that answers an odometry."""
    return CommandSample(stamp_ns=odometry.stamp_ns, throttle=throttle, w_WB_B=w_WB_B)
