# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The manifold formulation in the loop with the true rigid body."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.plant_motion import integrate
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.ocp.manifold import ManifoldProblem
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly

MANIFOLD = agile()


def errors(steps: list[LoopStep]) -> np.ndarray:
    return np.array([np.linalg.norm(s.window.p_WB[0] - s.odometry.p_WB) for s in steps])


@pytest.fixture(scope="module")
def square() -> list[LoopStep]:
    return list(fly(mpc=MANIFOLD, simulator=ideal(duration=10.0), reference=ReferenceConfig()))


def test_flies_square_on_true_rigid_body(square: list[LoopStep]) -> None:
    error = errors(square)
    assert np.sqrt(np.mean(error**2)) <= 0.712
    assert max(error[k] for k in (99, 199, 299, 399, 499)) <= 0.005
    last = square[-1].tick
    assert last is not None
    assert last.stats.solver_failures == last.stats.fallbacks == 0


def test_plans_match_true_rigid_body(square: list[LoopStep]) -> None:
    """The inputs of a plan lead to its predicted end.

    At 19 rad/s a substep turns by 0.24 rad, for which the direction half way is off by 0.24^2 / 24
    = 0.2 % of the thrust: millimetres over half a second.
    """
    for step in square[::25]:
        assert step.tick is not None
        plan = step.tick.plan
        assert plan is not None
        x = State(
            p_WB=step.odometry.p_WB,
            v_WB_B=step.odometry.v_WB_B,
            R_WB=so3.rotation_from_quaternion_xyzw(step.odometry.q_WB_xyzw),
        )
        for inputs in plan.inputs:
            for _ in range(4):
                x = integrate(
                    x,
                    Input(throttle=inputs[0], w_WB_B=inputs[1:]),
                    Vehicle(),
                    duration=plan.input_step / 4,
                )
        np.testing.assert_allclose(plan.p_WB[-1], x.p_WB, atol=5e-3)


@pytest.mark.parametrize("lagging", [False, True])
def test_sparsity_pattern_contains_every_entry_of_a_flight(
    lagging: bool, square: list[LoopStep]
) -> None:
    mpc = MANIFOLD.updated({"rate_time_constant": 0.03} if lagging else {})
    problem, delay_compensation = ManifoldProblem(mpc), DelayCompensation(mpc)
    pattern = problem.pattern()
    for step in square[100:160]:
        problem.begin(delay_compensation.predict(step.odometry), step.window)
        stages = problem.linearise()
        assert not stages.A[:, ~pattern.A].any()
        assert not stages.B[:, ~pattern.B].any()
        assert not stages.H[:, ~pattern.H].any()
