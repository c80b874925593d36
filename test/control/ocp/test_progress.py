# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Progress along the reference as a variable: slopes by finite differences through ⊞, solves."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.presets import agile
from fixtures.windows import window_through

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.parameters import parameters_of
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.reference_window import packed
from quad_mpc_ros.control.model.rollout import roll_out
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.mpc import Mpc
from quad_mpc_ros.control.ocp.horizon_qp import HorizonStages
from quad_mpc_ros.control.ocp.manifold import ManifoldProblem
from quad_mpc_ros.control.ocp.plan import PlannedTrajectory, apply_bounds
from quad_mpc_ros.control.ocp.problem import tracking_cost
from quad_mpc_ros.control.ocp.progress import (
    SIZE,
    SPEED_INPUT,
    SPEED_MAX,
    SPEED_MIN,
    follow_path,
    progress_cost,
)

CONTOURING = agile(
    formulation="contouring", rate_time_constant=0.03, thrust_time_constant=0.03, R=(0.1,) * 4
)
STAMP_NS = 10**9


def parabola(seed: int, *, stamp_ns: int = STAMP_NS) -> ReferenceWindow:
    """Return a path of constant acceleration, which the cubics between samples meet exactly."""
    rng = np.random.default_rng(seed)
    v, a = rng.normal(scale=4.0, size=3), rng.normal(scale=3.0, size=3)
    t = np.linspace(0.0, 2.0, 41)
    p = np.array([0.0, 0.0, 20.0]) + t[:, None] * v + 0.5 * t[:, None] ** 2 * a
    return window_through(t, p, stamp_ns=stamp_ns)


def off_the_path(
    config: MpcConfig, window: ReferenceWindow, seed: int, *, by: float = 1.0
) -> PredictedState:
    """Return a state next to the start of a path, with a different attitude."""
    rng = np.random.default_rng(seed)
    parameters = parameters_of(config.vehicle(), config.lags)
    state = PredictedState.at_rest(parameters)._replace(stamp_ns=window.stamp_ns)
    vehicle = state.prediction[()].state
    vehicle.p_WB[:] = window.p_WB[0] + by * rng.normal(scale=0.3, size=3)
    vehicle.v_WB_W[:] = window.v_WB_W[0] + by * rng.normal(scale=1.0, size=3)
    turn = so3.exp(by * rng.normal(scale=0.3, size=3))
    vehicle.R_WB[:] = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw[0]) @ turn
    vehicle.w_WB_B[:], vehicle.throttle = by * rng.normal(size=3), 0.3
    return state


def slopes_in_inputs(stages: HorizonStages) -> Array:
    """Return the gradient (N, nu) of the quadratic programme's cost where nothing changes."""
    slope, slopes = np.zeros(stages.g.shape[1]), np.zeros(stages.r.shape)
    for i in reversed(range(len(slopes))):
        slope = stages.g[i] + slope
        slopes[i] = stages.r[i] + stages.B[i].T @ slope
        slope = stages.A[i].T @ slope
    return slopes


@pytest.mark.parametrize("seed", range(4))
def test_gradient_of_the_cost_in_inputs_and_speeds(seed: int) -> None:
    window = parabola(seed)
    state = off_the_path(CONTOURING, window, seed)
    problem = ManifoldProblem(CONTOURING)
    problem.begin(state, window)
    stages = problem.linearise()
    work, settings = problem._problem.work, problem._settings[()]
    model = state.prediction[()].parameters

    def cost(change: Array) -> float:
        tried = PlannedTrajectory.zeros(CONTOURING.horizon_steps)
        tried.deviation[:] = work.nominal.deviation + change[:, :SPEED_INPUT]
        speeds = work.progress.nominal + change[:, SPEED_INPUT]
        target = work.target.copy()
        apply_bounds(settings, target, tried)
        roll_out(model, settings.step, tried.inputs, state.prediction[()].state, tried.states)
        follow_path(0, packed(window), settings.step, speeds, work.progress, target)
        errors = np.zeros((len(change), 9))
        tracked = tracking_cost(
            settings, settings.R, tried.states, target, tried.deviation, errors
        )
        return tracked + progress_cost(settings, speeds)

    shape = stages.r.shape
    expected, h = np.zeros(shape), 1e-5
    for place in np.ndindex(shape):
        step = np.zeros(shape)
        step[place] = h
        expected[place] = (cost(step) - cost(-step)) / (2.0 * h)
    is_free = stages.upper - stages.lower > 0.1
    np.testing.assert_allclose(
        2.0 * slopes_in_inputs(stages)[is_free], expected[is_free], rtol=2e-4, atol=2e-3
    )


def test_quadratic_cost_is_the_gauss_newton_model() -> None:
    """J' W J with the slopes of the errors in vehicle, time and speed; so it bends upwards."""
    window = parabola(3)
    problem = ManifoldProblem(CONTOURING)
    problem.begin(off_the_path(CONTOURING, window, 3), window)
    stages, path = problem.linearise(), problem._problem.work.progress.path
    speeds = problem._problem.work.progress.nominal
    for i, H in enumerate(stages.H):
        weight = CONTOURING.terminal_weight if i == len(stages.H) - 1 else 1.0
        v, a = path["v_WB_W"][i], path["a_WB_W"][i]
        J = np.zeros((6, SIZE))
        J[:, :6] = np.eye(6)
        J[:3, -2], J[3:, -2], J[3:, -1] = -v, -speeds[i] * a, -v
        expected = weight * J.T @ np.diag(CONTOURING.Q[:6]) @ J
        kept = [*range(6), SIZE - 2, SIZE - 1]
        np.testing.assert_allclose(H[np.ix_(kept, kept)], expected[np.ix_(kept, kept)])
        assert np.linalg.eigvalsh(H).min() > -1e-9 * np.abs(H).max()


@pytest.mark.parametrize("limits", [False, True])
def test_random_problems_are_all_solved(limits: bool) -> None:
    """Off the path by up to a metre, three metres a second and a radian, warm and cold."""
    config = CONTOURING if not limits else MpcConfig(formulation="contouring")
    mpc, iterations = Mpc(config), []
    for seed in range(500):
        stamp_ns = STAMP_NS * (seed + 1)
        window = parabola(seed, stamp_ns=stamp_ns)
        step = mpc.solve(off_the_path(config, window, seed), window)
        assert step.solution.solved and step.plan is not None
        assert np.isfinite(step.plan.inputs).all()
        assert (step.plan.speeds >= SPEED_MIN).all()
        assert (step.plan.speeds <= SPEED_MAX).all()
        iterations.append(step.iterations)
    # Over all linearisations; 95 and 120 were found.
    assert np.percentile(iterations, 99) <= 125


def test_progress_is_real_time_on_a_feasible_path() -> None:
    window = parabola(1)
    state = off_the_path(CONTOURING, window, 1, by=0.0)
    by_clock = Mpc(agile(rate_time_constant=0.03, thrust_time_constant=0.03, R=(0.1,) * 4))
    given_way, held = Mpc(CONTOURING).solve(state, window), by_clock.solve(state, window)
    assert given_way.plan is not None and held.plan is not None
    np.testing.assert_allclose(given_way.plan.p_WB, held.plan.p_WB, atol=0.05)
    assert len(held.plan.speeds) == 0 and held.plan.given_up(0.0, 1.0) == 0.0


def test_delay_is_the_integral_of_the_speeds() -> None:
    window = parabola(2)
    plan = Mpc(CONTOURING).solve(off_the_path(CONTOURING, window, 2), window).plan
    assert plan is not None
    times = (np.arange(100_000) + 0.5) * 1e-5  # 1 s, the horizon is half of it
    stages = np.floor(times / plan.step).astype(int)
    lost = np.where(stages < len(plan.speeds), 1.0 - np.pad(plan.speeds, (0, 100))[stages], 0.0)
    for since, until in ((0.0, 0.02), (0.013, 0.31), (0.4, 0.9)):
        inside = (times >= since) & (times < until)
        assert plan.given_up(since, until) == pytest.approx(1e-5 * lost[inside].sum(), abs=2e-5)
