# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Status of the solver after success, failure and invalid problems."""

from __future__ import annotations

import os
import signal
import threading

import numpy as np
import osqp
import pytest
from fixtures.stages import NAMES, changed
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.control.config import SolverParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.ocp.horizon_qp import HorizonPattern, HorizonQP, HorizonStages
from quad_mpc_ros.control.ocp.qp_solver import QpSolver


@pytest.fixture(scope="module")
def stages(flown_problems: list[HorizonStages]) -> list[HorizonStages]:
    """Return the horizons of a second of the paper's flight."""
    return flown_problems[100:150]


@pytest.fixture
def qp(flown_pattern: HorizonPattern) -> HorizonQP:
    return HorizonQP(flown_pattern)


def fresh_solution(qp: HorizonQP, stages: HorizonStages) -> Array:
    qp.update(stages)
    solution = QpSolver(qp, SolverParameters(tolerance=1e-9, max_iterations=20000)).solve()
    assert solution.solved
    return solution.z


def spoiled(stages: HorizonStages, name: str, value: float) -> HorizonStages:
    """Return the horizon with one of its numbers replaced."""
    numbers = np.array(getattr(stages, name))
    place = {"A": (4, 3, 3), "B": (4, 5, 0), "H": (4, 0, 0)}.get(name, (0,) * numbers.ndim)
    numbers[place] = value
    return changed(stages, **{name: numbers})


def test_warm_start_from_the_solution_converges_at_once(
    qp: HorizonQP, stages: list[HorizonStages]
) -> None:
    qp.update(stages[0])
    solver = QpSolver(qp, SolverParameters())
    cold = solver.solve()
    warm = solver.solve()
    # OSQP looks every 5 iterations; without the dual it would take as long as at first.
    assert warm.iterations == 5 < cold.iterations
    assert warm.primal_residual < cold.primal_residual or warm.primal_residual < 1e-6


def test_solution_is_not_overwritten(qp: HorizonQP, stages: list[HorizonStages]) -> None:
    """OSQP hands out copies: the next solve does not overwrite what it found before."""
    solver, found = QpSolver(qp, SolverParameters()), []
    for horizon in stages[:3]:
        qp.update(horizon)
        z = solver.solve().z
        found.append((z, z.copy()))
    for z, then in found:
        assert_array_equal(z, then)
    assert not np.array_equal(found[0][0], found[2][0])


def test_running_out_of_iterations_is_a_failure(
    qp: HorizonQP, stages: list[HorizonStages]
) -> None:
    qp.update(stages[0])
    solution = QpSolver(qp, SolverParameters(max_iterations=1)).solve()
    assert not solution.solved
    assert "maximum iterations" in solution.status
    assert solution.iterations == 1


def test_solve_after_a_failure_equals_a_fresh_solve(
    qp: HorizonQP, stages: list[HorizonStages]
) -> None:
    near = changed(stages[0], x0=np.zeros(9))
    expected = fresh_solution(qp, near)
    # So far away that these iterations are not enough, and the iterate is far away as well.
    far = changed(stages[0], x0=1000.0 * np.ones(9))
    solver = QpSolver(qp, SolverParameters(max_iterations=20))
    qp.update(far)
    assert not solver.solve().solved
    qp.update(near)
    solution = solver.solve()
    assert solution.solved
    assert_allclose(solution.z, expected, rtol=0.0, atol=5e-2)


# An infinite upper bound is none, and means something.
SPOILT = [(name, np.nan) for name in NAMES]
SPOILT += [(name, np.inf) for name in NAMES if name != "upper"]


@pytest.mark.parametrize(("name", "value"), SPOILT)
@pytest.mark.parametrize("first", [True, False], ids=["at first", "later"])
def test_nonfinite_problem_fails_without_lasting_effect(
    qp: HorizonQP, stages: list[HorizonStages], name: str, value: float, first: bool
) -> None:
    expected = fresh_solution(qp, stages[1])
    solver = QpSolver(qp, SolverParameters(tolerance=1e-4))
    if not first:
        qp.update(stages[0])
        assert solver.solve().solved
    with np.errstate(all="ignore"):
        qp.update(spoiled(stages[0], name, value))
    assert not solver.solve().solved

    qp.update(stages[1])
    solution = solver.solve()
    assert solution.solved
    assert np.isfinite(solution.z).all()
    assert_allclose(solution.z, expected, rtol=0.0, atol=5e-2)


@pytest.mark.parametrize("first", [True, False], ids=["at first", "later"])
@pytest.mark.parametrize("size", [1e31, 1e300])
def test_a_number_too_large_to_solve_with_is_a_failure(
    qp: HorizonQP, stages: list[HorizonStages], size: float, first: bool
) -> None:
    """OSQP refuses such an update and would then solve the previous problem again."""
    solver = QpSolver(qp, SolverParameters(tolerance=1e-4))
    if not first:
        qp.update(stages[0])
        assert solver.solve().solved
    qp.update(spoiled(stages[0], "x0", size))
    assert not solver.solve().solved
    qp.update(stages[1])
    assert solver.solve().solved


def test_solution_equals_osqp(
    flown_pattern: HorizonPattern, flown_problems: list[HorizonStages]
) -> None:
    """With the settings that were found for these problems, over a few ticks of a flight."""
    stages = flown_problems[100:106]
    qp = HorizonQP(flown_pattern)
    qp.update(stages[0])
    solver = QpSolver(qp, SolverParameters())
    solver.solve()
    reference = osqp.OSQP()
    reference.setup(
        P=qp.P, q=qp.q, A=qp.A, l=qp.lower, u=qp.upper, verbose=False,
        eps_abs=1e-3, eps_rel=1e-3, max_iter=400, scaling=1,
        check_termination=5, rho=0.3, alpha=1.4,
        adaptive_rho=1, adaptive_rho_interval=10,
    )  # fmt: skip
    expected = reference.solve(raise_error=False)
    for horizon in stages[1:]:
        qp.update(horizon)
        found = solver.solve()
        reference.update(q=qp.q, l=qp.lower, u=qp.upper, Px=qp.P.data, Ax=qp.A.data)
        reference.warm_start(x=expected.x, y=expected.y)
        expected = reference.solve(raise_error=False)
        assert_array_equal(found.z, expected.x)
        assert found.iterations == expected.info.iter
        assert found.primal_residual == expected.info.prim_res
        assert found.dual_residual == expected.info.dual_res
        assert found.status == expected.info.status


def test_ctrl_c_while_osqp_solves_is_not_lost(qp: HorizonQP, stages: list[HorizonStages]) -> None:
    qp.update(stages[0])
    endless = QpSolver(qp, SolverParameters(tolerance=1e-99, max_iterations=10**8))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    ctrl_c = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    try:
        ctrl_c.start()
        with pytest.raises(KeyboardInterrupt):
            endless.solve()
    finally:
        ctrl_c.join()
        signal.signal(signal.SIGINT, before)
