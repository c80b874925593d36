"""OSQP with one persistent problem: set up once, values updated in place, warm started.

Between set-up and set-up its compiled solver is called directly. The Python layer above it, which
does the same, spends a quarter of a solve on copying results that nobody reads; the tests compare
the two ways, with the oldest and the newest OSQP.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import osqp

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array
from quad_mpc_ros.lie.kernels import largest
from quad_mpc_ros.mpc_config import SolverParameters
from quad_mpc_ros.ocp.horizon_qp import HorizonQP


class QpSolution(NamedTuple):
    """What the solver returned; ``z`` is to be used only when ``solved``.

    Residuals are of the scaled problem, ``solve_time`` is OSQP's own in seconds.
    """

    solved: bool
    status: str
    z: Array
    iterations: int
    primal_residual: float
    dual_residual: float
    solve_time: float


_LARGEST = 1e15
_SOLVED = int(osqp.SolverStatus.OSQP_SOLVED)
_OUT_OF_TIME = int(osqp.SolverStatus.OSQP_TIME_LIMIT_REACHED)
_REFUSED = QpSolution(
    solved=False,
    status="not finite or too large",
    z=np.zeros(0),
    iterations=0,
    primal_residual=0.0,
    dual_residual=0.0,
    solve_time=0.0,
)


class _Compiled(NamedTuple):
    """OSQP's compiled solver, and where it says how it went and what it found.

    ``solution.x`` and ``.y`` are copies, new at each look. ``problem`` is what OSQP wraps it in.
    """

    problem: osqp.OSQP
    solver: Any
    info: Any
    solution: Any


class QpSolver:
    """Solves a :class:`HorizonQP` again and again, each time from the previous solution."""

    def __init__(
        self, qp: HorizonQP, parameters: SolverParameters, *, time_limit: float = math.inf
    ) -> None:
        """``time_limit`` [s] ends a solve that takes longer, unsolved."""
        self._qp = qp
        self._parameters = parameters
        self._time_limit = time_limit
        self._osqp: _Compiled | None = None
        self._z = self._zero = np.zeros(qp.A.shape[1])
        self._y = np.zeros(qp.A.shape[0])

    def solve(self, *, from_zero: bool = False) -> QpSolution:
        """Solve the problem as it stands in the QP, warm started in primal and dual.

        ``from_zero`` starts the primal at zero, for problems in deviations from a known plan.
        """
        if not self._is_solvable():
            self.forget()
            return _REFUSED
        _, solver, info, solution = self._updated()
        solver.warm_start(self._zero if from_zero else self._z, self._y)
        solver.solve()
        x, y = solution.x, solution.y
        # A solver may say "solved" and return NaN; the plan is what flies, so look at the plan.
        finite = _are_finite(x, y)
        solved = finite and info.status_val == _SOLVED
        late = finite and info.status_val == _OUT_OF_TIME
        if solved or late:  # what has been gained so far is not lost for the next one
            self._z, self._y = x, y
        else:
            self.forget()
        return QpSolution(
            solved=solved,
            status=info.status if finite else "not finite",
            z=self._z,
            iterations=info.iter,
            primal_residual=info.prim_res,
            dual_residual=info.dual_res,
            solve_time=info.run_time,
        )

    def forget(self) -> None:
        """Start the next solve from zero: after a failure the old iterate is no help."""
        self._z = np.zeros_like(self._z)
        self._y = np.zeros_like(self._y)

    def _is_solvable(self) -> bool:
        """Whether every number is finite and of a size that OSQP does not take for infinite.

        Given NaN, OSQP keeps its old data or says "solved"; it must not come to that.
        """
        # Written so that NaN, which compares with nothing, is refused.
        return self._qp.size() < _LARGEST

    def _limited(self) -> dict[str, float]:
        """Return OSQP's limit on time, which makes it look at the clock in each iteration."""
        return {"time_limit": self._time_limit} if math.isfinite(self._time_limit) else {}

    def _updated(self) -> _Compiled:
        """Return OSQP's compiled solver with the problem as it stands."""
        qp = self._qp
        if self._osqp is None:
            solver = osqp.OSQP()
            solver.setup(
                P=qp.P,
                q=qp.q,
                A=qp.A,
                l=qp.lower,
                u=qp.upper,
                verbose=False,
                warm_starting=True,
                polishing=False,
                eps_abs=self._parameters.tolerance,
                eps_rel=self._parameters.tolerance,
                max_iter=self._parameters.max_iterations,
                # The variables are scaled by their natural sizes already; what is left to
                # equilibrate costs as much time as it saves iterations after one pass.
                scaling=1,
                check_termination=5,
                # Found on the square and the lemniscate: a third fewer iterations than by default.
                rho=0.3,
                alpha=1.4,
                # Adapt the step size by iterations, never by the clock: two runs must agree.
                adaptive_rho=1,
                adaptive_rho_interval=10,
                **self._limited(),
            )
            # Only now: a setup that raises leaves none behind.
            compiled_solver = solver._solver
            self._osqp = _Compiled(
                solver, compiled_solver, compiled_solver.info, compiled_solver.solution
            )
        else:
            # By position: pybind11 takes a microsecond to sort out names.
            self._osqp.solver.update_data_vec(qp.q, qp.lower, qp.upper)
            self._osqp.solver.update_data_mat(qp.P.data, None, qp.A.data, None)
        return self._osqp


@compiled
def _are_finite(x: Array, y: Array) -> bool:
    return math.isfinite(largest(x)) and math.isfinite(largest(y))
