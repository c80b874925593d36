"""The sparse horizon against a dense one, its fixed pattern, and its scaling."""

from __future__ import annotations

import dataclasses

import numpy as np
import piqp
import pytest
from fixtures.stages import changed, stages_of
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.control.config import MpcConfig, SolverParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.mpc import Mpc
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


def exactly_solved(horizon: HorizonStages) -> tuple[Array, Array]:
    """Return inputs (N, nu) and states 1 to N by elimination of the states and PIQP."""
    steps, nx, nu = horizon.B.shape
    H = np.diag(horizon.R.ravel())
    g = horizon.r.ravel().copy()
    free, forced = horizon.x0, np.zeros((nx, steps * nu))
    states = []
    for i in range(steps):
        free = horizon.A[i] @ free
        forced = horizon.A[i] @ forced
        forced[:, i * nu : (i + 1) * nu] += horizon.B[i]
        H += forced.T @ horizon.H[i] @ forced
        g += forced.T @ (horizon.H[i] @ free + horizon.g[i])
        states.append((free, forced))
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-11
    solver.setup(
        P=np.asfortranarray(H),
        c=g,
        x_l=horizon.lower.ravel().copy(),
        x_u=horizon.upper.ravel().copy(),
        A=np.zeros((0, len(g)), order="F"),
        b=np.zeros(0),
    )
    assert solver.solve() == piqp.PIQP_SOLVED
    u = np.array(solver.result.x)
    return u.reshape(steps, nu), np.array([free + forced @ u for free, forced in states])


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
    exact_inputs, exact_states = exactly_solved(horizon)
    assert_allclose(inputs, exact_inputs, rtol=0.0, atol=1e-7)
    assert_allclose(states, exact_states, rtol=0.0, atol=1e-7)


def test_a_horizon_of_one_step_can_be_configured(paper_config: MpcConfig) -> None:
    Mpc(dataclasses.replace(paper_config, horizon_steps=1))


def test_the_solution_does_not_depend_on_the_sizes() -> None:
    horizon, pattern = a_horizon(5, seed=2), a_pattern(5)
    others = dataclasses.replace(
        pattern, state_size=pattern.state_size[::-1] ** 2, input_size=np.array([4.0, 0.7])
    )
    results = []
    for each in (pattern, others):
        qp = HorizonQP(each)
        qp.update(horizon)
        results.append(solved(qp))
    assert_allclose(results[0][0], results[1][0], atol=1e-7)
    assert_allclose(results[0][1], results[1][1], atol=1e-7)


def test_variables_are_divided_by_their_size() -> None:
    """A variable of one in the problem is one natural size in physical units."""
    pattern = a_pattern(2)
    finite, inputs, states = HorizonQP(pattern).read(np.ones(12), np.ones(12))
    assert finite
    assert_array_equal(inputs, np.tile(pattern.input_size, (2, 1)))
    assert_array_equal(states, np.tile(pattern.state_size, (2, 1)))


def test_rejects_stages_of_other_sizes() -> None:
    qp = HorizonQP(a_pattern(3))
    with pytest.raises(ValueError, match=r"stages: \(4, 4, 2, 0, 0\), expected \(3, 4, 2, 0, 0\)"):
        qp.update(a_horizon(4, seed=0))


def test_zeros_stay_in_the_pattern() -> None:
    horizon = a_horizon(3, seed=4)
    full, sparse = HorizonQP(a_pattern(3)), HorizonQP(a_pattern(3))
    full.update(horizon)
    sparse.update(
        changed(
            horizon,
            A=np.zeros_like(horizon.A),
            B=np.zeros_like(horizon.B),
            H=np.zeros_like(horizon.H),
            R=np.zeros_like(horizon.R),
        )
    )
    for name in ("P", "A"):
        one, other = getattr(full, name), getattr(sparse, name)
        assert one.nnz == other.nnz == len(other.data)
        assert_array_equal(one.indices, other.indices)
        assert_array_equal(one.indptr, other.indptr)
    assert not sparse.P.data.any()


def test_an_update_writes_in_place() -> None:
    qp = HorizonQP(a_pattern(3))
    arrays = (qp.P.data, qp.A.data, qp.q, qp.lower, qp.upper)
    qp.update(a_horizon(3, seed=5))
    assert all(
        now is before
        for now, before in zip(
            (qp.P.data, qp.A.data, qp.q, qp.lower, qp.upper), arrays, strict=True
        )
    )


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
        exact_inputs, _ = exactly_solved(horizon)
        assert_allclose(solution.inputs, exact_inputs, rtol=0.0, atol=tolerance)


def kkt_residuals(qp: HorizonQP, z: Array) -> tuple[float, float, float]:
    """Return primal and dual infeasibility and complementarity of a solution, from the data alone.

    The multipliers of the dynamics follow from stationarity in the states, those of the bounds
    are what is then left of the gradient in the inputs.
    """
    n, nx, nu = qp.pattern.steps, len(qp.pattern.state_size), len(qp.pattern.input_size)
    upper_triangle = qp.P.toarray()
    P = upper_triangle + np.triu(upper_triangle, 1).T
    A = qp.A.toarray()
    value = A @ z
    primal = max(np.max(qp.lower - value), np.max(value - qp.upper))

    is_input = np.tile(np.repeat([True, False], [nu, nx]), n)
    gradient = P @ z + qp.q
    dynamics = A[: n * nx]
    multipliers = np.linalg.solve(dynamics[:, ~is_input].T, -gradient[~is_input])
    reduced = gradient[is_input] + dynamics[:, is_input].T @ multipliers
    bounds = slice(n * nx, None)
    to_lower = value[bounds] - qp.lower[bounds]
    to_upper = qp.upper[bounds] - value[bounds]
    # A positive gradient must be held by the lower bound, a negative one by the upper.
    distance = np.where(reduced > 0.0, to_lower, to_upper)
    dual = np.max(np.where(distance > 1e-3, np.abs(reduced), 0.0))
    complementarity = np.max(np.abs(reduced) * np.maximum(distance, 0.0))
    return float(primal), float(dual), float(complementarity)


def test_solutions_satisfy_the_optimality_conditions(
    flown_problems: list[HorizonStages], flown_pattern: HorizonPattern
) -> None:
    qp = HorizonQP(flown_pattern)
    solver = QpSolver(qp, SolverParameters(tolerance=1e-4))
    for horizon in flown_problems:
        qp.update(horizon)
        solution = solver.solve()
        assert solution.solved
        primal, dual, complementarity = kkt_residuals(qp, solution.z)
        # OSQP's tolerance is 1e-4 absolute and relative, to terms of up to about 30.
        assert primal < 1e-3
        assert dual < 5e-3
        assert complementarity < 2e-2  # the dual residual times a range of up to 4


def test_tighter_tolerance_gives_smaller_residuals(
    flown_problems: list[HorizonStages], flown_pattern: HorizonPattern
) -> None:
    qp = HorizonQP(flown_pattern)
    solver = QpSolver(qp, SolverParameters(tolerance=1e-9, max_iterations=20000))
    for horizon in flown_problems[::25]:
        qp.update(horizon)
        solution = solver.solve()
        assert solution.solved
        assert max(kkt_residuals(qp, solution.z)) < 1e-6


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


def test_a_stage_touches_only_its_neighbours() -> None:
    """Interleaved variables make the factorisation cheap: cost grows with N, not its cube."""
    qp = HorizonQP(a_pattern(9))
    entries = qp.A.tocoo()
    dynamics = entries.row < 9 * 4
    stage_of_row, stage_of_column = entries.row // 4, entries.col // 6
    assert np.abs(stage_of_row - stage_of_column)[dynamics].max() == 1
