# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's flight, tick by tick, against its problem written a second time and solved exactly.

The oracle shares no code with the package: it takes the recorded odometry, reference and previous
command, builds the error-state problem from the paper with the states eliminated, and gives it to
an interior point solver.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import piqp
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.simulation.closed_loop import LoopStep

MASS, G, MU = 0.396893, 9.81, 0.2
A_T, B_T, C_T = 1.87953563, 2.79829004, -0.00514948
HOVER = (-B_T + math.sqrt(B_T**2 - 4.0 * A_T * (C_T - MASS * G / 4.0))) / (2.0 * A_T)
N, DT = 10, 0.05
Q = np.diag([10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 0.01, 0.01, 0.01])
R = np.diag([0.0, 0.001, 0.001, 0.001])
U_MIN = np.array([0.0, -6.0 * math.pi, -6.0 * math.pi, -3.0 * math.pi])
U_MAX = np.array([1.0, 6.0 * math.pi, 6.0 * math.pi, 3.0 * math.pi])
U_R = np.array([HOVER, 0.0, 0.0, 0.0])


def skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@dataclass(frozen=True, eq=False)
class CondensedProblem:
    """min 1/2 u'Hu + g'u over the stacked input errors, with bounds."""

    H: Array
    g: Array
    lower: Array
    upper: Array

    free: Array  # x_i without input errors, (N + 1, 9)
    forced: Array  # what they add, (N + 1, 9, 4 N)

    def states(self, u: Array) -> Array:
        return np.asarray(self.free + self.forced @ u)

    def cost(self, u: Array) -> float:
        return float(0.5 * u @ self.H @ u + self.g @ u)

    def solution(self) -> Array:
        solver = piqp.DenseSolver()
        solver.settings.eps_abs = solver.settings.eps_rel = 1e-10
        solver.settings.verbose = False
        n = len(self.g)
        solver.setup(
            P=np.asfortranarray(self.H),
            c=self.g,
            x_l=self.lower,
            x_u=self.upper,
            A=np.zeros((0, n), order="F"),
            b=np.zeros(0),
        )
        assert solver.solve() == piqp.PIQP_SOLVED
        return np.array(solver.result.x)


def condensed(odometry: OdometrySample, p_r: Array, throttle: float) -> CondensedProblem:
    """Return the paper's problem at an odometry, for a waypoint held level and heading east."""
    R_WB = Rotation.from_quat(odometry.q_WB_xyzw)
    v = odometry.v_WB_B
    # x̃ = x_r ⊟ x with v_r = 0 and R_r = I.
    x0 = np.concatenate((p_r - odometry.p_WB, -v, R_WB.inv().as_rotvec()))

    rotation = R_WB.as_matrix()
    g_B = rotation.T @ [0.0, 0.0, -G]
    zero, eye = np.zeros((3, 3)), np.eye(3)
    A = np.block(
        [[zero, rotation, -rotation @ skew(v)], [zero, -MU * eye, skew(g_B)], [zero, zero, zero]]
    )
    B = np.zeros((9, 4))
    s, s_error = throttle, HOVER - throttle
    B[5, 0] = 4.0 / MASS * (2.0 * A_T * s_error + 2.0 * A_T * s + B_T)
    B[6:, 1:] = eye

    # x_i = free[i] + forced[i] u, stacked over i = 0..N; forward Euler.
    free, forced = [x0], [np.zeros((9, 4 * N))]
    for i in range(N):
        free.append(free[-1] + DT * A @ free[-1])
        following = forced[-1] + DT * A @ forced[-1]
        following[:, 4 * i : 4 * i + 4] += DT * B
        forced.append(following)
    cost_H, cost_g = np.kron(np.eye(N), R), np.zeros(4 * N)
    for x_free, x_forced in zip(free, forced, strict=True):
        cost_H += x_forced.T @ Q @ x_forced
        cost_g += x_forced.T @ Q @ x_free
    return CondensedProblem(
        H=2.0 * cost_H,
        g=2.0 * cost_g,
        lower=np.tile(U_R - U_MAX, N),
        upper=np.tile(U_R - U_MIN, N),
        free=np.array(free),
        forced=np.array(forced),
    )


@dataclass(frozen=True, eq=False)
class Comparison:
    """Commands of the flight, (n, 4), beside the exact ones, and the problems they solve."""

    problems: list[CondensedProblem]
    exact_errors: Array  # stacked input errors of the exact solutions, (n, 4 N)
    sent: Array
    plans: Array  # planned inputs, (n, N, 4)

    @property
    def exact(self) -> Array:
        return U_R - self.exact_errors[:, :4]


@pytest.fixture(scope="module")
def comparison(paper_flight: list[LoopStep]) -> Comparison:
    problems, exact, sent, plans = [], [], [], []
    throttle = HOVER  # what is assumed to be in force before the first command
    for step in paper_flight:
        assert step.tick is not None
        assert step.tick.command is not None
        assert step.tick.plan is not None
        problem = condensed(step.odometry, step.window.p_WB[0], throttle)
        problems.append(problem)
        exact.append(problem.solution())
        throttle = step.tick.command.throttle
        sent.append([throttle, *step.tick.command.w_WB_B])
        plans.append(step.tick.plan.inputs)
    return Comparison(problems, np.array(exact), np.array(sent), np.array(plans))


def test_every_command_is_the_exact_solution(comparison: Comparison) -> None:
    error = np.abs(comparison.sent - comparison.exact) / (U_MAX - U_MIN)
    assert len(error) == 500
    assert np.percentile(error.max(axis=1), 99) < 0.01
    assert error.max() < 0.05


def test_the_flight_exercises_the_bounds(comparison: Comparison) -> None:
    """Without active bounds the comparison would not see one printed on the wrong side."""
    at_max = comparison.exact > U_MAX - 1e-6
    at_min = comparison.exact < U_MIN + 1e-6
    assert at_max[:, :3].any(axis=0).all()
    assert at_min[:, :3].any(axis=0).all()


def eq3(_: float, y: Array, u: Array) -> Array:
    """Eq. (3) with the attitude as the nine numbers of its rotation matrix."""
    v, rotation = y[3:6], y[6:].reshape(3, 3)
    s, w = u[0], u[1:]
    lift = 4.0 / MASS * (A_T * s**2 + B_T * s + C_T)
    dv = rotation.T @ [0.0, 0.0, -G] + [0.0, 0.0, lift] - MU * v
    return np.concatenate((rotation @ v, dv, (rotation @ skew(w)).ravel()))


def test_every_step_of_the_plant_follows_equation_3(paper_flight: list[LoopStep]) -> None:
    for step, following in itertools.pairwise(paper_flight):
        assert step.tick is not None
        assert step.tick.command is not None
        x, command = step.odometry, step.tick.command
        u = np.array([command.throttle, *command.w_WB_B])
        start = np.concatenate(
            (x.p_WB, x.v_WB_B, Rotation.from_quat(x.q_WB_xyzw).as_matrix().ravel())
        )
        duration = (following.odometry.stamp_ns - x.stamp_ns) * 1e-9
        end = solve_ivp(
            eq3, (0.0, duration), start, args=(u,), method="DOP853", rtol=1e-9, atol=1e-10
        ).y[:, -1]
        found = following.odometry
        assert_allclose(found.p_WB, end[:3], rtol=0.0, atol=1e-6)
        assert_allclose(found.v_WB_B, end[3:6], rtol=0.0, atol=1e-6)
        assert_allclose(
            Rotation.from_quat(found.q_WB_xyzw).as_matrix().ravel(), end[6:], rtol=0.0, atol=1e-8
        )
        assert_allclose(found.w_WB_B, command.w_WB_B, rtol=0.0, atol=0.0)


def tracking_errors(flight: list[LoopStep]) -> Array:
    return np.array([np.linalg.norm(step.window.p_WB[0] - step.odometry.p_WB) for step in flight])


def test_square_error_matches_the_reproduction(paper_flight: list[LoopStep]) -> None:
    errors = tracking_errors(paper_flight)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.788, abs=0.01)
    before_each_switch = errors[99::100]
    assert len(before_each_switch) == 5
    assert before_each_switch.max() <= 0.03


def test_plans_match_the_rollout_of_their_inputs(
    paper_flight: list[LoopStep], comparison: Comparison
) -> None:
    for step, problem in zip(paper_flight, comparison.problems, strict=True):
        assert step.tick is not None
        assert step.tick.plan is not None
        plan = step.tick.plan
        errors = problem.states((U_R - plan.inputs).ravel())
        assert_allclose(plan.p_WB, step.window.p_WB[0] - errors[:, :3], rtol=0.0, atol=5e-3)
        expected = Rotation.from_rotvec(-errors[:, 6:]).as_matrix()
        assert_allclose(plan.R_WB, expected, rtol=0.0, atol=5e-3)


def test_every_solve_is_accurate_within_few_iterations(paper_flight: list[LoopStep]) -> None:
    ticks = [step.tick for step in paper_flight if step.tick is not None]
    assert len(ticks) == 500
    iterations = [tick.stats.iterations for tick in ticks]
    assert np.percentile(iterations, 99) <= 75
    assert max(iterations) <= 100
    assert min(iterations) > 0
    assert {tick.stats.solver_status for tick in ticks} == {"solved"}
    assert {tick.stats.source for tick in ticks} == {"mpc"}
    last = ticks[-1].stats
    assert (last.commands, last.fallbacks, last.solver_failures, last.rejected_inputs) == (
        500,
        0,
        0,
        0,
    )
