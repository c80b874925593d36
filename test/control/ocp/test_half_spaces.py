# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Half-spaces on the position: rows, the QP by another solver, exact penalties, random states."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.exact_qp import exactly_solved, slacks_of
from fixtures.motions import odometry, unit
from fixtures.planner import Planner
from fixtures.presets import agile
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.configuration.errors import ConfigurationError
from quad_mpc_ros.control.config import MpcConfig, SolverParameters
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.mpc import MpcStep
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP
from quad_mpc_ros.control.ocp.limits import Limits, limits_cost
from quad_mpc_ros.control.ocp.manifold import ManifoldProblem
from quad_mpc_ros.control.ocp.qp_solver import QpSolver
from quad_mpc_ros.control.ocp.settings import ProblemSettings

ROWS = {"obstacles.half_spaces": 8}
START_NS = 10**9
PERIOD_NS = 20_000_000


def wall(config: MpcConfig, n: Array, b: float, *, stamp_ns: int = START_NS) -> Corridor:
    """Return a corridor on one side of a plane, at every stage."""
    normals = np.zeros((config.horizon_steps, 2, 3))
    offsets = np.full((config.horizon_steps, 2), np.inf)
    normals[:, 0], offsets[:, 0] = n, b
    return Corridor(stamp_ns=stamp_ns, step=config.horizon_step, normals=normals, offsets=offsets)


def converged(
    mpc: Planner, seen: OdometrySample, goal: Array, corridor: Corridor | None
) -> MpcStep:
    """Return the step after many iterations about the same state."""
    window = ReferenceWindow.hover(goal, stamp_ns=seen.stamp_ns)
    for _ in range(25):
        step = mpc.step(seen, window, corridor)
    assert step.plan is not None
    return step


def test_offsets_are_the_distances_to_the_plane_at_the_ends_of_stages() -> None:
    config = agile().updated(ROWS)
    n = np.array([0.6, 0.0, 0.8])
    seen = odometry(p_WB=np.array([1.0, 2.0, 3.0]), v_WB_W=np.array([1.0, 0.5, 0.0]))
    problem = ManifoldProblem(config)
    state = DelayCompensation(config).predict(seen)
    window = ReferenceWindow.hover(np.zeros(3), stamp_ns=START_NS)
    problem.begin(state, window, wall(config, n, 4.0))
    stages = problem.linearise()
    assert_allclose(stages.normals[:, 0, :3], np.tile(n, (10, 1)))
    assert_array_equal(stages.normals[:, 0, 3:], 0.0)
    # At hover thrust the first plan goes straight on, a little slower by drag.
    p = np.array([1.0, 2.0, 3.0]) + 0.05 * np.arange(1, 11)[:, None] * [1.0, 0.5, 0.0]
    assert_allclose(stages.offsets[:, 0], 4.0 - p @ n, atol=0.05)
    assert stages.offsets[:, 1:].min() >= 1e9, "rows that hold nothing are free"


@pytest.mark.parametrize("seed", range(4))
def test_solution_equals_that_of_another_solver(seed: int) -> None:
    """The problem of a flight towards planes at random, by PIQP from the same stages."""
    rng = np.random.default_rng(seed)
    config = agile().updated(ROWS)
    seen = odometry(p_WB=np.zeros(3), v_WB_W=3.0 * unit(rng))
    normals = np.array([unit(rng) for _ in range(80)]).reshape(10, 8, 3)
    offsets = rng.uniform(0.1, 1.0, size=(10, 8))
    corridor = Corridor(stamp_ns=START_NS, step=0.05, normals=normals, offsets=offsets)
    problem = ManifoldProblem(config)
    window = ReferenceWindow.hover(2.0 * unit(rng), stamp_ns=START_NS)
    problem.begin(DelayCompensation(config).predict(seen), window, corridor)
    qp = HorizonQP(problem.pattern(constrained=True))
    stages = problem.linearise()
    qp.update(stages)
    solution = QpSolver(qp, SolverParameters(tolerance=1e-9, max_iterations=100_000)).solve()
    inputs, states, slacks = exactly_solved(qp.pattern, stages)
    assert solution.solved
    assert_allclose(solution.states, states, atol=1e-4)
    assert_allclose(solution.inputs, inputs, atol=1e-3)
    assert_allclose(slacks_of(qp.pattern, solution.z), slacks, atol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_plan_satisfies_a_half_space_if_feasible(seed: int) -> None:
    """The penalty is exact: the plan reaches the plane and is not beyond it."""
    rng = np.random.default_rng(seed)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    config = MpcConfig().updated(ROWS)
    seen = odometry(p_WB=np.zeros(3), v_WB_W=0.3 * rng.normal(size=3))
    plan = converged(Planner(config), seen, 2.0 * n, wall(config, n, 0.4)).plan
    free = converged(Planner(config), seen, 2.0 * n, None).plan
    assert plan is not None and free is not None
    assert (free.p_WB @ n).max() > 0.6, "without the plane the plan goes beyond"
    assert (plan.p_WB @ n).max() == pytest.approx(0.4, abs=0.01)


def test_brakes_before_a_plane_as_late_as_limits_allow() -> None:
    """Towards a wall at speed, the reference beyond it: the wall is kept if it can be."""
    config = MpcConfig().updated({**ROWS, "limits.tilt_max": 0.8})
    n = np.array([1.0, 0.0, 0.0])
    seen = odometry(p_WB=np.zeros(3), v_WB_W=3.0 * n)
    plan = converged(Planner(config), seen, 4.0 * n, wall(config, n, 1.8)).plan
    assert plan is not None
    assert (plan.p_WB @ n).max() < 1.82


def test_commands_without_corridor_are_bit_identical() -> None:
    """Configured half-spaces change nothing without a corridor."""
    plain, ready = Planner(MpcConfig()), Planner(MpcConfig().updated(ROWS))
    rng = np.random.default_rng(0)
    for tick in range(20):
        stamp_ns = START_NS + tick * PERIOD_NS
        seen = odometry(p_WB=0.1 * rng.normal(size=3), v_WB_W=np.ones(3), stamp_ns=stamp_ns)
        window = ReferenceWindow.hover(np.ones(3), stamp_ns=stamp_ns)
        steps = [mpc.step(seen, window) for mpc in (plain, ready)]
        assert steps[0].plan is not None and steps[1].plan is not None
        assert steps[0].plan.inputs.tobytes() == steps[1].plan.inputs.tobytes()


def test_half_spaces_hold_at_their_times() -> None:
    """An older corridor is read at a later time, and its last half-spaces are held."""
    limits = Limits.zeros(ProblemSettings.zeros()[()], 4, half_spaces=3)
    normals = np.zeros((5, 1, 3))
    normals[..., 0] = 1.0
    offsets = np.arange(5.0)[:, None]
    corridor = Corridor(stamp_ns=0, step=0.1, normals=normals, offsets=offsets)
    limits.set_corridor(corridor, stamp_ns=200_000_000, step=0.1)
    assert_array_equal(limits.offsets[:, 0], [2.0, 3.0, 4.0, 4.0])
    assert limits.offsets[:, 1:].min() >= 1e9


def test_penalty_is_determined_by_the_most_violated_plane() -> None:
    limits = Limits.zeros(ProblemSettings.zeros()[()], 1, half_spaces=3)
    limits.weights[:] = 10.0
    limits.bounds[:] = 1e9
    limits.normals[0, :2] = np.eye(3)[:2]
    limits.offsets[0, :2] = 1.0, 2.0
    states = StateRecord.zeros(2)

    def cost(x: float, y: float) -> float:
        states["p_WB"] = x, y, 0.0
        penalty, _activity = limits_cost(limits, states)
        return penalty

    assert cost(1.0, 2.0) == 0.0
    assert cost(1.0 + 1e-6, 0.0) == pytest.approx(2e-5, rel=1e-3)
    assert cost(1.3, 2.1) == cost(1.3, 0.0) > cost(1.1, 2.1) > 0.0


def test_formulation_paper_refuses_half_spaces() -> None:
    with pytest.raises(ConfigurationError, match=r"half_spaces.*formulation paper"):
        MpcConfig().updated({**ROWS, "formulation": "paper"})


def a_random_case(seed: int) -> int:
    """Fly three ticks from any state among random planes; return the most iterations."""
    rng = np.random.default_rng(seed)
    changes = dict(ROWS)
    if rng.random() < 0.3:
        changes["limits.tilt_max"] = 0.0
    config = (agile() if rng.random() < 0.5 else MpcConfig()).updated(changes)
    mpc, most = Planner(config), 0
    p_WB, v_WB_W = np.zeros(3), rng.uniform(0.0, 10.0) * unit(rng)
    R_WB = so3.exp(rng.uniform(0.0, 1.5) * unit(rng))
    goal = rng.choice([0.5, 5.0, 40.0]) * unit(rng)
    mpc.sent(Input(throttle=0.3, w_WB_B=np.zeros(3)), stamp_ns=START_NS - PERIOD_NS)
    for tick in range(3):
        stamp_ns = START_NS + tick * PERIOD_NS
        normals = rng.normal(size=(config.horizon_steps, 8, 3))
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        offsets = rng.uniform(-1.0, 3.0, size=(config.horizon_steps, 8))
        offsets[rng.random(offsets.shape) < 0.3] = np.inf
        corridor = Corridor(
            stamp_ns=stamp_ns, step=config.horizon_step, normals=normals, offsets=offsets
        )
        seen = odometry(p_WB=p_WB, v_WB_W=v_WB_W, R_WB=R_WB, stamp_ns=stamp_ns)
        step = mpc.step(seen, ReferenceWindow.hover(goal, stamp_ns=stamp_ns), corridor)
        assert step.plan is not None, (seed, step.solution.status)
        most = max(most, step.iterations)
        p_WB = p_WB + 0.02 * v_WB_W
    return most


def test_no_problem_of_random_states_and_planes_fails() -> None:
    """Planes at random are often contradictory, and never infeasible."""
    assert max(a_random_case(seed) for seed in range(150)) < 3000
