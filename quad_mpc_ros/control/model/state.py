# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The state of the vehicle as a manifold: R^3 x R^3 x SO(3) with ⊞ and ⊟.

Paper, section 2.1 and [17]: x = (p, v, q) and u = (s, omega). Tangent order: position, velocity,
attitude.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample

# Where each part of the tangent begins.
P, V, THETA, TANGENT_SIZE = 0, 3, 6, 9
POSITION, VELOCITY, ATTITUDE = slice(P, V), slice(V, THETA), slice(THETA, TANGENT_SIZE)

# Where each part of the input begins.
U_THROTTLE, U_RATE, INPUT_SIZE = 0, 1, 4
BODY_RATE = slice(U_RATE, INPUT_SIZE)


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """Position in the world [m], velocity in the body [m/s], rotation body to world.

    Shapes: ``p_WB`` (3,), ``v_WB_B`` (3,), ``R_WB`` (3, 3), columns = body axes in the world.
    """

    p_WB: Array
    v_WB_B: Array
    R_WB: Array

    @property
    def v_WB_W(self) -> Array:
        """Velocity in the world frame [m/s], (3,)."""
        return np.asarray(self.R_WB @ self.v_WB_B)


class Input(NamedTuple):
    """Throttle signal in [0, 1] and body rate ``w_WB_B`` (3,) [rad/s]."""

    throttle: float
    w_WB_B: Array

    def vector(self) -> Array:
        """Return (throttle, rates) as one vector, (4,)."""
        return np.array((self.throttle, *self.w_WB_B.tolist()))


def boxminus(x: State, y: State) -> Array:
    """Return x ⊟ y (9,), the tangent at y that leads to x: y ⊞ (x ⊟ y) = x."""
    return np.concatenate(
        (x.p_WB - y.p_WB, x.v_WB_B - y.v_WB_B, so3.log(y.R_WB.T @ x.R_WB)),
    )


def state_from_odometry(odometry: OdometrySample) -> State:
    """Return the state of an odometry whose twist is in the body frame (REP-103)."""
    return State(
        p_WB=odometry.p_WB,
        v_WB_B=odometry.v_WB_B,
        R_WB=so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw),
    )


def with_body_twist(odometry: OdometrySample) -> OdometrySample:
    """Return an odometry with world-frame twist, with the twist in the body frame.

    Raises ``ValueError`` for a zero or non-finite quaternion.
    """
    R_BW = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw).T
    return dataclasses.replace(
        odometry, v_WB_B=R_BW @ odometry.v_WB_B, w_WB_B=R_BW @ odometry.w_WB_B
    )


def odometry_from_state(
    x: State, *, w_WB_B: Array, stamp_ns: int, frame_id: str, child_frame_id: str
) -> OdometrySample:
    """Return the odometry that reports the state ``x`` with body rates ``w_WB_B``."""
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=x.p_WB,
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(x.R_WB),
        v_WB_B=x.v_WB_B,
        w_WB_B=w_WB_B,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
    )
