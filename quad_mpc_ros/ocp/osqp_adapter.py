"""OSQP's compiled solver, called directly: the one file that uses what OSQP keeps to itself.

The Python layer of OSQP spends a quarter of a solve on copying results that nobody reads. The
tests compare the two ways, with the oldest and the newest OSQP, and say what a new version lacks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import osqp
import scipy.sparse as sp

from quad_mpc_ros.lie import Array

SOLVED = int(osqp.SolverStatus.OSQP_SOLVED)
OUT_OF_TIME = int(osqp.SolverStatus.OSQP_TIME_LIMIT_REACHED)
OUT_OF_ITERATIONS = int(osqp.SolverStatus.OSQP_MAX_ITER_REACHED)


class OsqpResult(NamedTuple):
    """Outcome of a solve: primal ``x`` and dual ``y`` are arrays of their own, new each time.

    ``status`` is one of OSQP's numbers, ``status_text`` what it says of it. ``run_time`` in
    seconds.
    """

    status: int
    status_text: str
    x: Array
    y: Array
    iterations: int
    primal_residual: float
    dual_residual: float
    run_time: float


class OsqpAdapter:
    """A QP ``min 1/2 x'Px + q'x, lower <= Ax <= upper`` that is set up once."""

    def __init__(
        self,
        *,
        P: sp.csc_matrix,
        q: Array,
        A: sp.csc_matrix,
        lower: Array,
        upper: Array,
        settings: dict[str, float],
    ) -> None:
        """Set up OSQP. ``P`` is the upper triangle; ``settings`` are OSQP's own, by its names."""
        self._osqp = osqp.OSQP()
        self._osqp.setup(P=P, q=q, A=A, l=lower, u=upper, **settings)
        self._solver = self._osqp._solver
        # They are views of what the solver writes; each look at x and y makes a copy.
        self._info, self._solution = self._solver.info, self._solver.solution

    def update(self, *, q: Array, lower: Array, upper: Array, P: Array, A: Array) -> None:
        """Give it other vectors, and other entries ``P`` and ``A`` of the same pattern."""
        # By position: pybind11 takes a microsecond to sort out names.
        self._solver.update_data_vec(q, lower, upper)
        self._solver.update_data_mat(P, None, A, None)

    def solve(self, x: Array, y: Array) -> OsqpResult:
        """Solve, warm started in primal ``x`` and dual ``y``."""
        self._solver.warm_start(x, y)
        self._solver.solve()
        info, solution = self._info, self._solution
        return OsqpResult(
            status=info.status_val,
            status_text=info.status,
            x=solution.x,
            y=solution.y,
            iterations=info.iter,
            primal_residual=info.prim_res,
            dual_residual=info.dual_res,
            run_time=info.run_time,
        )


set_up: Callable[..., OsqpAdapter] = OsqpAdapter
"""What new problems are set up with: what fails on demand may be put in its place."""
