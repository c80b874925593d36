# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Samples made from the little that a person knows."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow


def test_yaw_of_90_degrees_points_the_nose_north() -> None:
    odometry = OdometrySample.at_rest([1, 2, 3], yaw=np.pi / 2, stamp_ns=7)
    assert odometry.stamp_ns == 7 and odometry.speed == 0.0 and odometry.up == 1.0
    assert_allclose(Rotation.from_quat(odometry.q_WB_xyzw).apply([1, 0, 0]), [0, 1, 0], atol=1e-15)
    assert_allclose(odometry.p_WB, [1.0, 2.0, 3.0])


def test_hover_window_holds_its_position_for_its_duration() -> None:
    window = ReferenceWindow.hover([1.0, 0.0, 2.0], yaw=np.pi / 2, stamp_ns=5, duration=1.5)
    assert window.stamp_ns == 5 and window.offset_ns.tolist() == [0, 1_500_000_000]
    assert_allclose(window.p_WB, [[1.0, 0.0, 2.0]] * 2)
    assert_allclose(
        Rotation.from_quat(window.q_WB_xyzw).apply([1, 0, 0]), [[0, 1, 0]] * 2, atol=1e-15
    )
    assert not (window.v_WB_W.any() or window.a_WB_W.any() or window.w_WB_W.any())


def test_pose_at_is_on_the_line_between_samples() -> None:
    window = ReferenceWindow(
        stamp_ns=100,
        offset_ns=np.array([0, 10, 10, 30]),
        p_WB=np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [5.0, 0.0, 1.0], [5.0, 2.0, 1.0]]),
        q_WB_xyzw=np.eye(4),
        v_WB_W=np.zeros((4, 3)),
        a_WB_W=np.zeros((4, 3)),
        w_WB_W=np.zeros((4, 3)),
    )
    for stamp_ns, p_WB, sample in (
        (0, [0.0, 0.0, 1.0], 0),
        (100, [0.0, 0.0, 1.0], 0),
        (105, [0.5, 0.0, 1.0], 0),
        (110, [5.0, 0.0, 1.0], 2),
        (120, [5.0, 1.0, 1.0], 2),
        (130, [5.0, 2.0, 1.0], 3),
        (999, [5.0, 2.0, 1.0], 3),
    ):
        p, q = window.pose_at(stamp_ns)
        assert p.tolist() == p_WB
        assert q.tolist() == np.eye(4)[sample].tolist()
