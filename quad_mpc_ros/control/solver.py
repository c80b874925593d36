"""OSQP with one persistent problem: set up once, values updated in place, warm started."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import osqp

from quad_mpc_ros.control.config import SolverParameters
from quad_mpc_ros.control.horizon_qp import HorizonQP
from quad_mpc_ros.core.messages import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class QpSolution:
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
_REFUSED = QpSolution(
    solved=False,
    status="not finite or too large",
    z=np.zeros(0),
    iterations=0,
    primal_residual=0.0,
    dual_residual=0.0,
    solve_time=0.0,
)


class QpSolver:
    """Solves a :class:`HorizonQP` again and again, each time from the previous solution."""

    def __init__(self, qp: HorizonQP, parameters: SolverParameters) -> None:
        self._qp = qp
        self._parameters = parameters
        self._osqp: osqp.OSQP | None = None
        self._z = self._zero = np.zeros(qp.A.shape[1])
        self._y = np.zeros(qp.A.shape[0])

    def solve(self, *, from_zero: bool = False) -> QpSolution:
        """Solve the problem as it stands in the QP, warm started in primal and dual.

        ``from_zero`` starts the primal at zero, for problems in deviations from a known plan.
        """
        if not self._is_solvable():
            self.forget()
            return _REFUSED
        solver = self._updated()
        solver.warm_start(x=self._zero if from_zero else self._z, y=self._y)
        result = solver.solve(raise_error=False)
        # A solver may say "solved" and return NaN; the plan is what flies, so look at the plan.
        finite = bool(np.isfinite(result.x).all() and np.isfinite(result.y).all())
        solved = result.info.status_val == osqp.SolverStatus.OSQP_SOLVED and finite
        if solved:
            self._z, self._y = result.x, result.y
        else:
            self.forget()
        return QpSolution(
            solved=solved,
            status=result.info.status if finite else "not finite",
            z=self._z,
            iterations=int(result.info.iter),
            primal_residual=float(result.info.prim_res),
            dual_residual=float(result.info.dual_res),
            solve_time=float(result.info.run_time),
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
        return self._qp.largest() < _LARGEST

    def _updated(self) -> osqp.OSQP:
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
                # Adapt the step size by iterations, never by the clock: two runs must agree.
                adaptive_rho=1,
                adaptive_rho_interval=10,
            )
            self._osqp = solver  # only now: a setup that raises leaves none behind
        else:
            self._osqp.update(q=qp.q, l=qp.lower, u=qp.upper, Px=qp.P.data, Ax=qp.A.data)
        return self._osqp
