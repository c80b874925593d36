# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The manifold formulation in the loop with the true rigid body."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.plant_motion import integrate
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input, State, odometry_from_state
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.ocp.manifold import ManifoldProblem
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly

MANIFOLD = agile()
PERIOD = 0.02


def flown(mpc: MpcConfig, **simulator: object) -> list[LoopStep]:
    return list(
        fly(
            mpc=mpc,
            simulator=ideal({"duration": 10.0, **simulator}),
            reference=ReferenceConfig(),
        )
    )


def errors(steps: list[LoopStep]) -> np.ndarray:
    return np.array([np.linalg.norm(s.window.p_WB[0] - s.odometry.p_WB) for s in steps])


@pytest.fixture(scope="module")
def square() -> list[LoopStep]:
    return flown(MANIFOLD)


def test_flies_square_on_true_rigid_body(square: list[LoopStep]) -> None:
    error = errors(square)
    assert np.sqrt(np.mean(error**2)) <= 0.712
    assert max(error[k] for k in (99, 199, 299, 399, 499)) <= 0.005
    last = square[-1].tick
    assert last is not None
    assert last.stats.solver_failures == last.stats.fallbacks == 0


def test_two_flights_command_the_same(square: list[LoopStep]) -> None:
    for a, b in zip(square, flown(MANIFOLD), strict=True):
        assert a.tick is not None
        assert b.tick is not None
        assert a.tick.command is not None
        assert b.tick.command is not None
        assert a.tick.command.throttle == b.tick.command.throttle
        np.testing.assert_array_equal(a.tick.command.w_WB_B, b.tick.command.w_WB_B)


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


@pytest.mark.parametrize("mass_scale", [0.85, 1.2])
def test_wrong_mass_leaves_no_steady_error(mass_scale: float) -> None:
    """Offset-free: what is left just before each switch is that of the right mass."""
    steps = flown(MANIFOLD, mass_scale=mass_scale)
    assert max(errors(steps)[k] for k in (199, 299, 399, 499)) <= 0.005
    last = steps[-1].tick
    assert last is not None
    assert last.stats.thrust_scale == pytest.approx(1.0 / mass_scale, abs=0.03)


@pytest.mark.parametrize("seed", range(12))
def test_recovers_from_any_attitude_at_10_m_per_s_5_m_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = so3.exp(rng.uniform(0.0, np.pi) * _unit(rng))
    goal = np.array([0.0, 0.0, 50.0])
    x = State(p_WB=goal + 5.0 * _unit(rng), v_WB_B=R.T @ (10.0 * _unit(rng)), R_WB=R)
    controller, u = Controller(MANIFOLD), Input(throttle=0.3, w_WB_B=np.zeros(3))
    for k in range(120):
        stamp_ns = 10**9 + round(k * PERIOD * 1e9)
        controller.receive_reference(_held(goal, stamp_ns), now_ns=stamp_ns)
        tick = controller.receive_odometry(_odometry(x, u, stamp_ns), now_ns=stamp_ns)
        assert tick is not None
        if tick.command is not None:
            u = Input(throttle=tick.command.throttle, w_WB_B=tick.command.w_WB_B)
        for _ in range(4):
            x = integrate(x, u, Vehicle(), duration=PERIOD / 4)
    assert np.linalg.norm(x.p_WB - goal) < 0.1


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


def _unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def _held(p_WB: np.ndarray, stamp_ns: int) -> ReferenceWindow:
    rest = np.zeros((2, 3))
    return ReferenceWindow(
        stamp_ns=stamp_ns,
        offset_ns=np.array([0, 2 * 10**9]),
        p_WB=np.tile(p_WB, (2, 1)),
        q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)),
        v_WB_W=rest,
        a_WB_W=rest,
        w_WB_W=rest,
    )


def _odometry(x: State, u: Input, stamp_ns: int) -> OdometrySample:
    return odometry_from_state(
        x, w_WB_B=u.w_WB_B, stamp_ns=stamp_ns, frame_id="odom", child_frame_id="base_link"
    )
