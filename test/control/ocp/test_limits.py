# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Soft limits: rows by finite differences, the QP by another solver, and penalty weights."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from fixtures.exact_qp import exactly_solved, slacks_of
from fixtures.motions import odometry, unit
from fixtures.planner import Planner
from fixtures.presets import agile
from fixtures.stages import changed
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.config import MpcConfig, SolverParameters
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.rollout import SUBSTEPS, StateRecord, roll_forward, roll_out
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.ocp.horizon_qp import (
    NO_LIMITS,
    HorizonPattern,
    HorizonQP,
    HorizonStages,
    LimitPattern,
)
from quad_mpc_ros.control.ocp.limits import Limits, limits_cost
from quad_mpc_ros.control.ocp.manifold import ManifoldProblem
from quad_mpc_ros.control.ocp.qp_solver import QpSolution, QpSolver
from quad_mpc_ros.control.ocp.settings import settings_of

EXACT = SolverParameters(tolerance=1e-10, max_iterations=50000)
LIMITS = {
    "limits.tilt_max": 0.6,
    "limits.speed_max": 4.0,
}
LAGS = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03}
PERIOD_NS = 20_000_000


def begun(
    config: MpcConfig, seen: OdometrySample, goal: Array
) -> tuple[ManifoldProblem, DelayCompensation]:
    """Return a problem that has begun, and what predicts its states."""
    problem, compensation = ManifoldProblem(config), DelayCompensation(config)
    compensation.record(Input(throttle=0.4, w_WB_B=np.ones(3)), stamp_ns=seen.stamp_ns - PERIOD_NS)
    window = ReferenceWindow.hover(goal, stamp_ns=seen.stamp_ns)
    problem.begin(compensation.predict(seen), window)
    return problem, compensation


def held(predicted: PredictedState) -> RecordArray[StateRecord]:
    """Return the states 1 to N (N,) where the reference's inputs lead: the first iterate."""
    inputs, states = np.zeros((10, SUBSTEPS, 4)), StateRecord.zeros(11)
    inputs[:, :, 0] = agile().vehicle().hover_throttle
    start = predicted.prediction[()].state
    roll_out(predicted.parameters[()], 0.05, inputs=inputs, start=start, states=states)
    return states[1:]


# --- the rows


def tilt(rotation: Array) -> float:
    return math.acos(max(-1.0, min(1.0, rotation[2, 2])))


@pytest.mark.parametrize("seed", range(8))
def test_rows_are_the_derivatives_of_tilt_and_speed(seed: int) -> None:
    """One side of the square touches the disc where the rollout is, and turns with it."""
    rng = np.random.default_rng(seed)
    R0 = so3.exp(rng.uniform(0.3, 2.5) * unit(rng))
    seen = odometry(R_WB=R0, p_WB=np.zeros(3), v_WB_W=rng.uniform(2.0, 8.0) * unit(rng))
    problem, compensation = begun(agile().updated(LIMITS), seen, np.array([1.0, 2.0, 0.5]))
    stages = problem.linearise()
    states = held(compensation.predict(seen))
    for i in range(len(states)):
        R, v = states[i].R_WB, states[i].v_WB_W
        h = 1e-6
        turned = [
            (tilt(R @ so3.exp(h * e)) - tilt(R @ so3.exp(-h * e))) / (2 * h) for e in np.eye(3)
        ]
        normals, offsets = stages.normals[i], stages.offsets[i]
        assert_allclose(normals[0, 6:9], turned, atol=1e-5)
        assert_allclose(normals[1], -normals[0])
        assert_allclose(offsets[0], 0.6 - tilt(R), atol=1e-9)
        assert_allclose(offsets[1], 0.6 + tilt(R), atol=1e-9)
        # Across it the tilt does not change, and a turn moves the thrust's axis as far.
        assert_allclose(normals[2] @ normals[0], 0.0, atol=1e-12)
        assert_allclose(np.linalg.norm(normals[2]), 1.0)
        assert_allclose(normals[3], -normals[2])
        assert_allclose(offsets[2:4], 0.6)
        assert_allclose(normals[4, 3:6], v / np.linalg.norm(v), atol=1e-12)
        assert_allclose(offsets[4], 4.0 - np.linalg.norm(v), atol=1e-9)


def test_limits_yield_to_demanding_reference() -> None:
    """Inverted, at 9 m/s: the limits allow the reference and a margin."""
    rest = np.zeros((2, 3))
    window = ReferenceWindow(
        stamp_ns=10**9,
        offset_ns=np.array([0, 2 * 10**9]),
        p_WB=rest,
        q_WB_xyzw=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        v_WB_W=np.tile([9.0, 0.0, 0.0], (2, 1)),
        a_WB_W=rest,
        w_WB_W=rest,
    )
    config = agile().updated(LIMITS)
    inverted = so3.exp(np.array([np.pi, 0.0, 0.0]))
    seen = odometry(R_WB=inverted, p_WB=np.zeros(3), v_WB_W=np.array([9.0, 0.0, 0.0]))
    problem = ManifoldProblem(config)
    problem.begin(DelayCompensation(config).predict(seen), window)
    stages = problem.linearise()
    assert stages.offsets[:, 0].min() > 1e6
    assert stages.offsets[0, 4] > 0.5


def test_disabled_limits_are_not_in_the_problem() -> None:
    plain = HorizonQP(ManifoldProblem(agile()).pattern())
    far_off = agile().updated({"advanced.limits.position_error_max": 0.1})
    other = HorizonQP(ManifoldProblem(far_off).pattern())
    assert plain.A.shape == other.A.shape == (10 * 13, 10 * 13)
    for name in LIMITS:
        config = agile().updated({name: LIMITS[name]})
        assert HorizonQP(ManifoldProblem(config).pattern()).A.shape[1] == 10 * 14


def test_limits_change_in_flight_and_stay_in_the_pattern() -> None:
    level = odometry(p_WB=np.zeros(3), v_WB_W=np.zeros(3))
    config = agile().updated(LIMITS)
    problem, compensation = begun(config, level, np.zeros(3))
    qp = HorizonQP(problem.pattern())
    qp.update(problem.linearise())
    before = [array.copy() for array in (qp.A.indices, qp.A.indptr, qp.P.indices, qp.P.indptr)]
    problem.reconfigure(config.updated({"limits.tilt_max": 0.3, "limits.speed_max": 9.0}))
    window = ReferenceWindow.hover(np.zeros(3), stamp_ns=level.stamp_ns)
    problem.begin(compensation.predict(level), window)
    stages = problem.linearise()
    assert_allclose(stages.offsets[:, 0], 0.3, atol=1e-9)
    assert_allclose(stages.offsets[:, 4], 9.0, atol=1e-9)
    qp.update(stages)
    for now, then in zip(
        (qp.A.indices, qp.A.indptr, qp.P.indices, qp.P.indptr), before, strict=True
    ):
        assert_array_equal(now, then)


# --- the QP


def a_soft_horizon(
    seed: int, *, weight: float, room: float
) -> tuple[HorizonPattern, HorizonStages]:
    """Return a horizon in which every number is its own, with six soft rows and two slacks."""
    rng = np.random.default_rng(seed)
    n, nx, nu, nr, ns = 5, 4, 2, 6, 2
    pattern = HorizonPattern(
        steps=n,
        A=np.ones((nx, nx), dtype=bool),
        B=np.ones((nx, nu), dtype=bool),
        H=np.ones((nx, nx), dtype=bool),
        state_size=np.linspace(0.5, 3.0, nx),
        input_size=np.linspace(0.3, 2.0, nu),
        limits=LimitPattern(
            mask=np.ones((nr, nx), dtype=bool),
            slack_of=np.array([0, 0, 0, 0, 1, 1]),
            slack_size=np.array([0.5, 2.0]),
        ),
    )
    stages = HorizonStages.zeros(n, nx, nu, nr=nr, ns=ns)
    factors = rng.normal(size=(n, nx, nx))
    stages.x0[:] = 0.3 * rng.normal(size=nx)
    stages.A[:], stages.B[:] = 0.4 * rng.normal(size=(n, nx, nx)), rng.normal(size=(n, nx, nu))
    stages.H[:] = factors @ factors.transpose(0, 2, 1) + np.eye(nx)
    stages.g[:], stages.r[:] = rng.normal(size=(n, nx)), rng.normal(size=(n, nu))
    stages.R[:] = rng.uniform(0.1, 1.0, size=(n, nu))
    stages.lower[:], stages.upper[:] = -1.0, 1.0
    stages.normals[:] = rng.normal(size=(n, nr, nx))
    stages.offsets[:] = room
    stages.linear[:], stages.quadratic[:] = weight, 0.1 * weight
    return pattern, stages


def solved(qp: HorizonQP, parameters: SolverParameters = EXACT) -> QpSolution:
    solution = QpSolver(qp, parameters).solve()
    assert solution.solved
    return solution


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("weight", [0.3, 30.0])
def test_sparse_solution_equals_that_of_another_solver(seed: int, weight: float) -> None:
    pattern, stages = a_soft_horizon(seed, weight=weight, room=0.3)
    qp = HorizonQP(pattern)
    qp.update(stages)
    solution = solved(qp)
    inputs, states, slacks = exactly_solved(pattern, stages)
    assert_allclose(solution.inputs, inputs, atol=1e-5)
    assert_allclose(solution.states, states, atol=1e-5)
    assert_allclose(slacks_of(pattern, solution.z), slacks, atol=1e-5)
    assert slacks.max() > 0.01 or weight > 1.0, "a small weight allows slack"


@pytest.mark.parametrize("seed", range(4))
def test_feasible_limits_are_satisfied_exactly(seed: int) -> None:
    """A large weight gives the solution of hard limits, without slack."""
    pattern, stages = a_soft_horizon(seed, weight=1e3, room=0.8)
    qp = HorizonQP(pattern)
    qp.update(stages)
    solution = solved(qp)
    hard, _, _ = exactly_solved(pattern, stages, eased=False)
    unlimited, _, _ = exactly_solved(pattern, changed(stages, offsets=1e6))
    assert np.abs(hard - unlimited).max() > 1e-3, "a limit holds"
    assert slacks_of(pattern, solution.z).max() < 1e-7
    assert_allclose(solution.inputs, hard, atol=1e-5)


def out_of_iterations(pattern: HorizonPattern, stages: HorizonStages) -> QpSolution:
    """Return the solution of the solve that just does not become as accurate as it should."""
    for most in range(5, 400, 5):
        qp = HorizonQP(pattern)
        qp.update(stages)
        solution = QpSolver(qp, SolverParameters(max_iterations=most)).solve()
        if solution.status == "solved inaccurate":
            return solution
    raise AssertionError("it is solved or not at all")


def test_inaccurate_step_is_accepted_only_with_soft_rows() -> None:
    """With them a line search follows, without them it would be the plan."""
    pattern, stages = a_soft_horizon(2, weight=30.0, room=0.3)
    soft = out_of_iterations(pattern, stages)
    assert soft.solved
    assert soft.primal_residual < 0.1
    hard = dataclasses.replace(pattern, limits=NO_LIMITS)
    zeros = HorizonStages.zeros(5, 4, 2)
    same = {name: getattr(stages, name) for name in ("x0", "A", "B", "H", "g", "R", "r")}
    bounds = {"lower": stages.lower, "upper": stages.upper}
    assert not out_of_iterations(hard, zeros._replace(**same, **bounds)).solved


# --- penalty in the line search


def test_penalty_equals_weight_of_true_excess() -> None:
    limits = Limits.zeros(settings_of(agile().updated(LIMITS))[()], 1)
    limits.bounds[:] = 0.5, 4.0
    limits.weights[:2] = 10.0, 20.0
    states = StateRecord.zeros(2)

    def cost(angle: float, speed: float) -> float:
        states["R_WB"] = so3.exp(np.array([0.6 * angle, -0.8 * angle, 0.0]))
        states["v_WB_W"] = 0.0, speed, 0.0
        penalty, _activity = limits_cost(limits, states)
        return penalty

    assert cost(0.5, 4.0) == pytest.approx(0.0, abs=1e-12)
    # Twice the weight, as the cost is twice that of the QP, and with an excess a little more.
    for beyond, weight in (
        (lambda d: cost(0.5 + d, 3.0), 10.0),
        (lambda d: cost(0.2, 4.0 + d), 20.0),
    ):
        assert beyond(1e-6) == pytest.approx(2e-6 * weight, rel=1e-3)
        assert 2.0 * 0.1 * weight < beyond(0.1) < 3.0 * 0.1 * weight


# --- random states and limits


def a_random_case(seed: int) -> list[QpSolution]:
    """Return the solves of three ticks from any attitude, up to 10 m/s and 40 m, as it moves."""
    rng = np.random.default_rng(seed)
    tilt_max, speed_max, _, _, tilt, speed, _, _ = rng.random(8)
    chosen: dict[str, object] = {}
    if tilt < 0.8:
        chosen["limits.tilt_max"] = 0.2 + tilt_max
    if speed < 0.7:
        chosen["limits.speed_max"] = 1.0 + 9.0 * speed_max
    weights = agile() if rng.random() < 0.5 else MpcConfig()
    if rng.random() < 0.7:
        chosen |= LAGS
    R = so3.exp(rng.uniform(0.0, np.pi) * unit(rng))
    goal = np.array([0.0, 0.0, 50.0])
    p_WB = goal + rng.choice([0.5, 5.0, 40.0]) * rng.random() * unit(rng)
    v_WB_W = rng.uniform(0.0, 10.0) * unit(rng)
    mpc, stamp_ns, solutions = Planner(weights.updated(chosen)), 10**9, []
    u = Input(throttle=rng.uniform(0.0, 1.0), w_WB_B=rng.uniform(-5.0, 5.0, size=3))
    mpc.sent(u, stamp_ns=stamp_ns - PERIOD_NS)
    for _ in range(3):
        seen = odometry(R_WB=R, p_WB=p_WB, v_WB_W=v_WB_W, stamp_ns=stamp_ns)
        step = mpc.step(seen, ReferenceWindow.hover(goal, stamp_ns=stamp_ns))
        solutions.append(step.solution)
        assert step.plan is not None, (seed, step.solution.status)
        u = step.plan.command_over(0.0, 0.02)
        mpc.sent(u, stamp_ns=stamp_ns)
        state = step.state.prediction[()].state.copy()
        roll_forward(
            step.state.prediction[()].parameters,
            commands=u.vector()[None],
            durations=np.array([0.02]),
            start=state,
            end=state,
        )
        p_WB, v_WB_W, R = state.p_WB, state.v_WB_W, state.R_WB
        stamp_ns += PERIOD_NS
    return solutions


def test_solves_random_states_and_limits_within_few_iterations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    iterations: list[int] = []
    original = QpSolver.solve

    def solve(solver: QpSolver, **how: bool) -> QpSolution:
        solution = original(solver, **how)
        iterations.append(solution.iterations)
        return solution

    monkeypatch.setattr(QpSolver, "solve", solve)
    for seed in range(500):
        a_random_case(seed)
    assert len(iterations) > 1500
    assert np.percentile(iterations, 99) <= 100
    assert max(iterations) <= 300
