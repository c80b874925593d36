# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Attitude along a thrust that goes anywhere: continuous where a single chart is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.flatness import ThrustFrames
from quad_mpc_ros.references.path import PathSamples


class Tumbling:
    """A path whose thrust, of 20 m/s^2, wanders from upwards past straight down and back."""

    duration = 3.0
    periodic = False

    def __init__(self, miss: float) -> None:
        self._miss = miss

    def at(self, seconds: Array) -> PathSamples:
        h = 1e-4
        force = 20.0 * np.stack([self._direction(seconds + k * h) for k in (-1, 0, 1)])
        rest = np.zeros((len(seconds), 3))
        return PathSamples(
            p_WB=rest,
            v_WB_W=rest,
            a_WB_W=force[1] - [0.0, 0.0, 9.81],
            j_WB_W=(force[2] - force[0]) / (2.0 * h),
        )

    def _direction(self, seconds: Array) -> Array:
        """Down at half time but for an angle ``miss``."""
        angle = 2.0 * np.pi * seconds / self.duration
        side = np.stack((np.sin(angle), 0.0 * angle, np.cos(angle)), axis=-1)
        tilt = so3.exp([self._miss, 0.0, 0.0])
        return np.asarray(side @ tilt.T)


def attitudes(trajectory: FlatTrajectory, step_ns: int) -> tuple[Array, Array]:
    samples = trajectory.at(list(range(0, trajectory.period_ns, step_ns)))
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)
    return R_WB, np.einsum("nji,nj->ni", R_WB, samples.w_WB_W)


@settings(deadline=None, max_examples=20)
@given(st.one_of(st.floats(-0.5, 0.5), st.sampled_from([0.0, 1e-12, 1e-7, 1e-3, -1e-2])))
def test_body_does_not_spin_near_downward_thrust(miss: float) -> None:
    """The single chart of the Hopf fibration would spin it by a whole turn at once."""
    R_WB, w_WB_B = attitudes(FlatTrajectory(Tumbling(miss), ReferenceConfig(drag=0.0)), 1_000_000)
    assert R_WB[:, 2, 2].min() < -0.8
    assert np.abs(w_WB_B[:, 2]).max() < 0.02
    # No more is turned than the thrust axis turns: 2 pi in 3 s.
    assert np.linalg.norm(w_WB_B, axis=1).max() < 2.0 * np.pi / 3.0 + 0.02
    turns = so3.log(np.swapaxes(R_WB[:-1], -1, -2) @ R_WB[1:])
    assert np.linalg.norm(turns, axis=1).max() < 1.02e-3 * 2.0 * np.pi / 3.0


def test_yaw_is_defined_for_thrust_above_the_horizon() -> None:
    """One chart, whatever the way taken: the shortest tilt from level, after the yaw."""
    rng = np.random.default_rng(3)
    z = rng.normal(size=(50, 3))
    z[:, 2] = np.abs(z[:, 2])
    z /= np.linalg.norm(z, axis=1, keepdims=True)

    class Scattered:
        duration = 1.0
        periodic = False

        def at(self, seconds: Array) -> PathSamples:
            place = np.clip((50 * seconds).astype(int), 0, 49)
            rest = np.zeros((len(seconds), 3))
            force = 15.0 * z[place]
            return PathSamples(
                p_WB=rest, v_WB_W=rest, a_WB_W=force - [0.0, 0.0, 9.81], j_WB_W=rest
            )

    R_WB, _ = attitudes(
        FlatTrajectory(Scattered(), ReferenceConfig(drag=0.0), yaw=0.6), 20_000_000
    )
    tilts = so3.log(R_WB @ so3.exp([0.0, 0.0, -0.6]))
    assert_allclose(tilts[:, 2], 0.0, atol=1e-12)  # about a horizontal axis: the shortest


unit_vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(
    lambda v: float(np.linalg.norm(v)) > 0.1
)


@given(unit_vectors, unit_vectors)
def test_shortest_rotations(first: tuple[float, ...], second: tuple[float, ...]) -> None:
    a, b = (np.array([v]) / np.linalg.norm(v) for v in (first, second))
    if float(np.sum(a * b)) < -0.999:
        return
    R = so3.shortest_rotation(a, b)[0]
    assert_allclose(R @ a[0], b[0], atol=1e-9)
    assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
    # Shortest: by the angle between them and no more.
    angle = np.arctan2(np.linalg.norm(np.cross(a, b)), np.sum(a * b))
    assert np.linalg.norm(so3.log(R)) == pytest.approx(angle, abs=1e-7)


def test_rejects_a_thrust_that_reverses_instantly() -> None:
    z = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    with pytest.raises(ValueError, match="reverses"):
        ThrustFrames(np.array([0.0, 1.0]), z)
