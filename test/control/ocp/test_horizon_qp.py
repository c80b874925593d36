# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The sparse horizon against a dense one, its fixed pattern, and its scaling."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.exact_qp import exactly_solved
from fixtures.stages import changed, stages_of
from numpy.testing import assert_allclose

from quad_mpc_ros.control.config import SolverParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.ocp.horizon_qp import HorizonPattern, HorizonQP, HorizonStages
from quad_mpc_ros.control.ocp.qp_solver import QpSolver

EXACT = SolverParameters(tolerance=1e-10, max_iterations=20000)


def a_pattern(steps: int, nx: int = 4, nu: int = 2) -> HorizonPattern:
    return HorizonPattern(
        steps=steps,
        A=np.ones((nx, nx), dtype=bool),
        B=np.ones((nx, nu), dtype=bool),
        H=np.ones((nx, nx), dtype=bool),
        state_size=np.linspace(0.5, 3.0, nx),
        input_size=np.linspace(0.3, 2.0, nu),
    )


def a_horizon(steps: int, seed: int, nx: int = 4, nu: int = 2) -> HorizonStages:
    """Return a horizon in which every number of every stage is its own."""
    rng = np.random.default_rng(seed)
    factors = rng.normal(size=(steps, nx, nx))
    return stages_of(
        x0=rng.normal(size=nx),
        A=0.4 * rng.normal(size=(steps, nx, nx)),
        B=rng.normal(size=(steps, nx, nu)),
        H=factors @ factors.transpose(0, 2, 1) + np.eye(nx),
        g=rng.normal(size=(steps, nx)),
        R=rng.uniform(0.1, 1.0, size=(steps, nu)),
        r=rng.normal(size=(steps, nu)),
        lower=-rng.uniform(0.05, 0.5, size=(steps, nu)),
        upper=rng.uniform(0.05, 0.5, size=(steps, nu)),
    )


def solved(qp: HorizonQP, parameters: SolverParameters = EXACT) -> tuple[Array, Array]:
    solution = QpSolver(qp, parameters).solve()
    assert solution.solved
    return solution.inputs, solution.states


@pytest.mark.parametrize("steps", [1, 2, 3, 7])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_sparse_problem_has_the_solution_of_the_dense_one(steps: int, seed: int) -> None:
    horizon = a_horizon(steps, seed)
    qp = HorizonQP(a_pattern(steps))
    qp.update(horizon)
    inputs, states = solved(qp)
    exact_inputs, exact_states, _slacks = exactly_solved(qp.pattern, horizon)
    assert_allclose(inputs, exact_inputs, rtol=0.0, atol=1e-7)
    assert_allclose(states, exact_states, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("parameters", [EXACT, SolverParameters()])
def test_updating_in_place_equals_a_fresh_problem(parameters: SolverParameters) -> None:
    qp = HorizonQP(a_pattern(6))
    solver = QpSolver(qp, parameters)
    tolerance = 1e-7 if parameters is EXACT else 5e-3
    first = a_horizon(6, seed=6)
    # From a problem full of zeros to a full one and back: no entry may be left behind.
    emptier = changed(first, A=np.zeros_like(first.A), g=np.zeros_like(first.g))
    for horizon in (emptier, first, a_horizon(6, seed=7), emptier):
        qp.update(horizon)
        solution = solver.solve()
        assert solution.solved
        exact_inputs, _states, _slacks = exactly_solved(qp.pattern, horizon)
        assert_allclose(solution.inputs, exact_inputs, rtol=0.0, atol=tolerance)


def test_the_pattern_of_the_flight_never_changes(
    flown_problems: list[HorizonStages], flown_pattern: HorizonPattern
) -> None:
    qp = HorizonQP(flown_pattern)
    patterns = {matrix_pattern(qp)}
    zeros = []
    for horizon in flown_problems:
        qp.update(horizon)
        patterns.add(matrix_pattern(qp))
        zeros.append(int(np.sum(qp.A.data == 0.0)))
        # Nothing of the stage falls outside the pattern, where it would be lost.
        assert not horizon.A[0][~qp.pattern.A].any()
        assert not horizon.B[0][~qp.pattern.B].any()
    assert len(patterns) == 1
    # On the ground, level and at rest, much is zero that is not later.
    assert zeros[0] > 100 + min(zeros)


def matrix_pattern(qp: HorizonQP) -> tuple[bytes, ...]:
    arrays = (qp.P.indices, qp.P.indptr, qp.A.indices, qp.A.indptr)
    assert (len(qp.P.data), len(qp.A.data)) == (qp.P.indptr[-1], qp.A.indptr[-1])
    return tuple(array.tobytes() for array in arrays)
