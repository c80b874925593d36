# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Loop and flip: what they look like, and what the vehicle does in them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.trajectory import TrajectorySamples


def flown(**changes: object) -> tuple[TrajectorySamples, Array, float]:
    """Return samples of a trajectory, their rotations, and the time between them [s]."""
    trajectory = configured_trajectory(ReferenceConfig.build(changes))
    times = np.linspace(0, trajectory.period_ns, 2001).astype(int).tolist()
    samples = trajectory.at(times)
    step = 1e-9 * trajectory.period_ns / 2000
    return samples, so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw), step


def turned(R_WB: Array) -> Array:
    """Return the sum of all small turns in body axes: the revolutions made, as angles."""
    return so3.log(np.swapaxes(R_WB[:-1], -1, -2) @ R_WB[1:]).sum(axis=0)


@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi])
def test_loop_is_a_circle_with_continuous_pitch(yaw: float) -> None:
    samples, R_WB, _ = flown(trajectory="vertical_loop", yaw=yaw, origin=[1.0, 2.0], height=3.0)
    forward, left = np.array([np.cos(yaw), np.sin(yaw), 0.0]), [-np.sin(yaw), np.cos(yaw), 0.0]
    from_centre = samples.p_WB - [1.0, 2.0, 4.5]
    assert_allclose(np.linalg.norm(from_centre, axis=1), 1.5, atol=1e-9)
    assert_allclose(from_centre @ left, 0.0, atol=1e-9)
    # One whole turn, nose up, about the body's y axis and no other.
    assert_allclose(turned(R_WB), [0.0, -2.0 * np.pi, 0.0], atol=1e-6)
    top = len(R_WB) // 2
    assert R_WB[top, 2, 2] < -0.99  # but for the drag, straight down
    assert_allclose(samples.v_WB_W[top], -5.5 * forward, atol=1e-6)
    assert R_WB[top, :, 0] @ -forward > 0.99


def test_rejects_a_loop_too_slow_at_the_top() -> None:
    with pytest.raises(ConfigurationError, match=r"^reference\.loop_speed: given 4\.0, .*4\.2"):
        flown(trajectory="vertical_loop", loop_speed=4.0)
    flown(trajectory="vertical_loop", loop_speed=4.5)


@pytest.mark.parametrize(
    ("axis", "revolution"), [("pitch", [0.0, 2.0, 0.0]), ("roll", [2.0, 0.0, 0.0])]
)
@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_flip_rotates_once_and_ends_at_its_start(
    axis: str, revolution: list[float], yaw: float
) -> None:
    samples, R_WB, _ = flown(trajectory="flip", flip_axis=axis, yaw=yaw)
    assert_allclose(turned(R_WB), np.pi * np.array(revolution), atol=1e-6)
    assert_allclose(samples.p_WB[-1], samples.p_WB[0], atol=1e-9)
    assert_allclose(R_WB[-1], R_WB[0], atol=1e-6)
    rates = np.linalg.norm(samples.w_WB_W, axis=1)
    assert rates.max() == pytest.approx(12.0, abs=0.01)
    assert samples.p_WB[:, 2].min() == pytest.approx(2.0, abs=1e-4)


def test_inverted_flip_has_its_coasting_thrust() -> None:
    samples, R_WB, _ = flown(trajectory="flip", coasting_thrust=0.4)
    inverted = R_WB[:, 2, 2] < 0.0
    force = samples.a_WB_W + 0.2 * samples.v_WB_W + [0.0, 0.0, 9.81]
    assert np.count_nonzero(inverted) > 100
    assert_allclose(np.linalg.norm(force[inverted], axis=1), 0.4 * 9.81)
