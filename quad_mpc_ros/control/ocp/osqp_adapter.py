"""OSQP as this package uses it: set up once, then other numbers of the same pattern."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import NamedTuple

import osqp
from scipy import sparse

from quad_mpc_ros.control.lie import Array

SOLVED = int(osqp.SolverStatus.OSQP_SOLVED)
SOLVED_INACCURATE = int(osqp.SolverStatus.OSQP_SOLVED_INACCURATE)
"""Out of iterations, within ten times the tolerance."""
OUT_OF_TIME = int(osqp.SolverStatus.OSQP_TIME_LIMIT_REACHED)
_INTERRUPTED = int(osqp.SolverStatus.OSQP_SIGINT)
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
        P: sparse.csc_matrix,
        q: Array,
        A: sparse.csc_matrix,
        lower: Array,
        upper: Array,
        settings: dict[str, float],
    ) -> None:
        """Set up OSQP. ``P`` is the upper triangle; ``settings`` are OSQP's own, by its names."""
        self._solver = osqp.OSQP()
        self._solver.setup(P=P, q=q, A=A, l=lower, u=upper, **settings)

    def update(self, *, q: Array, lower: Array, upper: Array, P: Array, A: Array) -> None:
        """Give it other vectors, and other entries ``P`` and ``A`` of the same pattern."""
        self._solver.update(q=q, l=lower, u=upper, Px=P, Ax=A)

    def solve(self, x: Array, y: Array) -> OsqpResult:
        """Solve, warm started in primal ``x`` and dual ``y``.

        While it solves OSQP hears SIGINT in place of who else would: it is raised again, or
        Ctrl-C would be lost.
        """
        self._solver.warm_start(x=x, y=y)
        result = self._solver.solve(raise_error=False)
        info = result.info
        if info.status_val == _INTERRUPTED:
            signal.raise_signal(signal.SIGINT)
        return OsqpResult(
            status=info.status_val,
            status_text=info.status,
            x=result.x,
            y=result.y,
            iterations=info.iter,
            primal_residual=info.prim_res,
            dual_residual=info.dual_res,
            run_time=info.run_time,
        )


set_up: Callable[..., OsqpAdapter] = OsqpAdapter
"""What new problems are set up with: what fails on demand may be put in its place."""
