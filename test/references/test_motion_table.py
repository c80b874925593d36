# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Motions that are flown as they are given: between their rows, as files, and refused ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory, judged_trajectory
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.minimum_snap import minimum_snap_path
from quad_mpc_ros.references.motion_table import MotionTable, PlannedMotion

POINTS = np.array([[0.0, 0.0, 1.0], [3.0, 1.0, 2.0], [0.0, 4.0, 1.5]])


def smooth() -> FlatTrajectory:
    """Return a motion by flatness, from rest to rest."""
    path = minimum_snap_path(POINTS, max_speed=8.0, max_acceleration=9.0)
    return FlatTrajectory(path, ReferenceConfig(drag=0.2))


def table(trajectory: FlatTrajectory, step: float = 0.01) -> MotionTable:
    duration = 1e-9 * trajectory.period_ns
    seconds = np.linspace(0.0, duration, 1 + round(duration / step))
    samples = trajectory.at(nanoseconds(seconds))
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)
    return MotionTable(
        source="here",
        seconds=seconds,
        p_WB=samples.p_WB,
        v_WB_W=samples.v_WB_W,
        a_WB_W=samples.a_WB_W,
        q_WB_xyzw=samples.q_WB_xyzw,
        w_WB_B=np.einsum("nji,nj->ni", R_WB, samples.w_WB_W),
    )


def nanoseconds(seconds: Array) -> list[int]:
    return [round(1e9 * each) for each in seconds]


def test_interpolates_the_motion_between_rows() -> None:
    trajectory = smooth()
    motion = PlannedMotion(table(trajectory))
    times = nanoseconds(np.linspace(0.0, 1e-9 * trajectory.period_ns, 999)[:-1])
    true, found = trajectory.at(times), motion.at(times)
    assert_allclose(found.p_WB, true.p_WB, atol=1e-6)
    assert_allclose(found.v_WB_W, true.v_WB_W, atol=1e-4)
    assert_allclose(found.a_WB_W, true.a_WB_W, atol=1e-2)
    assert_allclose(found.w_WB_W, true.w_WB_W, atol=1e-2)
    turns = [so3.rotation_from_quaternion_xyzw(each.q_WB_xyzw) for each in (true, found)]
    assert_allclose(so3.log(np.swapaxes(turns[0], -1, -2) @ turns[1]), 0.0, atol=3e-4)


def test_rests_before_and_after() -> None:
    motion = PlannedMotion(table(smooth()), offset=np.array([1.0, 2.0, 0.0]))
    found = motion.at([-5, motion.period_ns, motion.period_ns + 10**9])
    assert_allclose(found.p_WB, POINTS[[0, 2, 2]] + [1.0, 2.0, 0.0], atol=1e-9)
    assert not found.v_WB_W.any() and not found.a_WB_W.any() and not found.w_WB_W.any()


def test_file_is_the_same_motion(tmp_path: Path) -> None:
    given = table(smooth())
    file = tmp_path / "motion.csv"
    file.write_text(given.text())
    config = ReferenceConfig(trajectory="csv", file=str(file), origin=(2.0, 0.0))
    found, verdict = judged_trajectory(config)
    times = list(range(0, found.period_ns, 7_000_000))
    expected = PlannedMotion(given, offset=np.array([2.0, 0.0, 0.0])).at(times)
    for name in ("p_WB", "v_WB_W", "a_WB_W", "w_WB_W"):
        assert_allclose(getattr(found.at(times), name), getattr(expected, name), atol=2e-4)
    assert verdict.feasible and found.smooth and not found.jumps(-1, found.period_ns)


def test_rows_that_begin_or_end_in_motion_are_refused(tmp_path: Path) -> None:
    whole = table(smooth())
    for place, name in ((slice(50, None), "first"), (slice(0, -50), "last")):
        rows = {
            field.name: getattr(whole, field.name)[place]
            for field in dataclasses.fields(whole)
            if field.name != "source"
        }
        with pytest.raises(UserError, match=f"here: the {name} row moves at .* starts and ends"):
            MotionTable(source="here", **rows)


def test_rejects_an_invalid_attitude(tmp_path: Path) -> None:
    given = table(smooth())
    given.q_WB_xyzw[3] *= 1.1
    file = tmp_path / "motion.csv"
    file.write_text(given.text())
    with pytest.raises(UserError, match=r"row 3 .* quaternion of length 1.1, expected 1"):
        configured_trajectory(ReferenceConfig(trajectory="csv", file=str(file)))


def test_rejects_an_infeasible_motion_without_slowing_down(tmp_path: Path) -> None:
    path = minimum_snap_path(POINTS, max_speed=30.0, max_acceleration=60.0)
    file = tmp_path / "motion.csv"
    file.write_text(table(FlatTrajectory(path, ReferenceConfig(drag=0.2))).text())
    with pytest.raises(UserError, match="highest throttle"):
        configured_trajectory(ReferenceConfig(trajectory="csv", file=str(file)))
