# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The window of a guide by the physics that it has to have."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.extras.obstacles.guide import STEP, follow_path, smoothed, window_of


def test_thrust_matches_the_motion_and_attitudes_are_continuous() -> None:
    way = smoothed(np.array([[0.0, 0.0, 1.0], [2.0, 0.5, 1.0], [2.0, 3.0, 2.0]]))
    speeds = np.array([3.0] * (len(way) - 1) + [0.0])
    start, north = np.zeros(3), np.array([0.0, 2.0, 0.0])
    motion = follow_path(way, speeds, 5.0, p_W=start, v_W=north, duration=2.0)
    window = window_of(motion, ReferenceWindow.hover(start, yaw=0.7), start_ns=0, gravity=9.81)
    R_WB = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw)
    force = window.a_WB_W + np.array([0.0, 0.0, 9.81])
    thrust = np.linalg.norm(force, axis=1, keepdims=True) * R_WB[:, :, 2]
    np.testing.assert_allclose(thrust, force, atol=1e-9)
    turns = so3.exp(STEP * window.w_WB_W[:-1])
    np.testing.assert_allclose(turns @ R_WB[:-1], R_WB[1:], atol=1e-9)
    by_v = np.gradient(window.v_WB_W, STEP, axis=0)
    np.testing.assert_allclose(window.a_WB_W, by_v, atol=1e-9)
    tilt = so3.shortest_rotation(np.tile([0.0, 0.0, 1.0], (len(R_WB), 1)), R_WB[:, :, 2])
    nose = np.tile([np.cos(0.7), np.sin(0.7), 0.0], (len(R_WB), 1))
    np.testing.assert_allclose(
        (np.swapaxes(tilt, 1, 2) @ R_WB)[:, :, 0], nose, atol=1e-9, err_msg="the heading asked for"
    )
