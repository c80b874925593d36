"""One persistent QP: set up once, values updated in place, warm started, its solution judged."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.config import SolverParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.ocp import osqp_adapter
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP


class QpSolution(NamedTuple):
    """What the solver returned, to be used only when ``solved``.

    ``z`` are the variables as the solver has them, ``inputs`` (N, nu) and ``states`` 1 to N
    (N, nx) the same in physical units. Residuals are of the scaled problem, ``solve_time`` is
    OSQP's own in seconds.
    """

    solved: bool
    status: str
    z: Array
    inputs: Array
    states: Array
    iterations: int
    primal_residual: float
    dual_residual: float
    solve_time: float


_LARGEST = 1e15  # larger numbers OSQP takes for infinite
_REFUSED = QpSolution(
    solved=False,
    status="not finite or too large",
    z=np.zeros(0),
    inputs=np.zeros((0, 0)),
    states=np.zeros((0, 0)),
    iterations=0,
    primal_residual=0.0,
    dual_residual=0.0,
    solve_time=0.0,
)


class QpSolver:
    """Solves a :class:`HorizonQP` again and again, each time from the previous solution."""

    def __init__(
        self,
        qp: HorizonQP,
        parameters: SolverParameters,
        *,
        time_limit: float = math.inf,
        progress: bool = False,
    ) -> None:
        """``time_limit`` [s] ends a solve that takes longer, unsolved.

        ``progress`` along the reference is among the variables, and no half-spaces are.
        """
        self._qp, self._progress = qp, progress
        # With soft rows it is a step, of which a line search takes what lowers the true cost, so
        # one that is less accurate is of use as well. Without them it is the plan itself.
        inaccurate = [osqp_adapter.SOLVED_INACCURATE] if qp.is_soft else []
        self._accepted = {osqp_adapter.SOLVED, *inaccurate}
        self._settings = _settings(parameters, time_limit, soft=qp.is_soft)
        if progress:
            self._settings |= _PROGRESS_SETTINGS
        self._osqp: osqp_adapter.OsqpAdapter | None = None
        self._z = self._zero = np.zeros(qp.A.shape[1])
        self._y = np.zeros(qp.A.shape[0])

    def solve(self, *, from_zero: bool = False, again: bool = False) -> QpSolution:
        """Solve the problem as it stands in the QP, warm started in primal and dual.

        ``from_zero`` starts the primal at zero, for problems in deviations from a known plan.
        ``again`` is to say that the problem is that of the last solve, linearised elsewhere.
        """
        # Given NaN, OSQP keeps its old data or says "solved"; it must not come to that. Written so
        # that NaN, which compares with nothing, is refused.
        if not self._qp.magnitude < _LARGEST:
            self.forget()
            return _REFUSED
        qp, z, y = self._qp, self._zero if from_zero else self._z, self._y
        if qp.is_soft:
            if again and self._progress:
                y[qp.first_soft_row :] = 0.0
            z, y = qp.settled(z, y)
        result = self._updated().solve(z, y)
        # A solver may say "solved" and return NaN; the plan is what flies, so look at the plan.
        finite, inputs, states = qp.read(result.x, result.y)
        solved = finite and result.status in self._accepted
        late = finite and result.status == osqp_adapter.OUT_OF_TIME
        if solved or late:  # what has been gained so far is not lost for the next one
            self._z, self._y = result.x, result.y
        else:
            self.forget()
        return QpSolution(
            solved=solved,
            status=result.status_text if finite else "not finite",
            z=self._z,
            inputs=inputs,
            states=states,
            iterations=result.iterations,
            primal_residual=result.primal_residual,
            dual_residual=result.dual_residual,
            solve_time=result.run_time,
        )

    def forget(self) -> None:
        """Start the next solve from zero: after a failure the old iterate is no help."""
        self._z = np.zeros_like(self._z)
        self._y = np.zeros_like(self._y)

    def _updated(self) -> osqp_adapter.OsqpAdapter:
        """Return OSQP with the problem as it stands."""
        qp = self._qp
        if self._osqp is None:
            self._osqp = osqp_adapter.set_up(
                P=qp.P, q=qp.q, A=qp.A, lower=qp.lower, upper=qp.upper, settings=self._settings
            )
        else:
            self._osqp.update(q=qp.q, lower=qp.lower, upper=qp.upper, P=qp.P.data, A=qp.A.data)
        return self._osqp


# What differs with soft rows, found on jumps and on random states and limits: half the iterations.
_SOFT_SETTINGS = {"scaling": 3, "rho": 0.7, "alpha": 1.6}
# Their cost is divided by its steepest slope, so that the tolerance is a share of that.
_SOFT_TOLERANCE = 2.0

# With progress, whose curvature is small and changes with the speed of the reference, the step
# size is adapted where it is off by 1.7 times, not by five: a quarter off the iterations of the
# slowest hundredth of random problems without soft rows, a tenth with. Soft rows of the tilt turn
# from one linearisation to the next, and begin again without multipliers: a fifth off. Not with
# half-spaces, where the step size went to and fro until a solve failed.
_PROGRESS_SETTINGS = {"adaptive_rho_tolerance": 1.7}


def _settings(parameters: SolverParameters, time_limit: float, *, soft: bool) -> dict[str, float]:
    """Return OSQP's settings, for problems with soft rows or without."""
    tolerance = parameters.tolerance * (_SOFT_TOLERANCE if soft else 1.0)
    settings: dict[str, float] = {
        "verbose": False,
        "warm_starting": True,
        "polishing": False,
        "eps_abs": tolerance,
        "eps_rel": tolerance,
        "max_iter": parameters.max_iterations,
        # The variables are scaled by their natural sizes already; what is left to equilibrate
        # costs as much time as it saves iterations after one pass.
        "scaling": 1,
        "check_termination": 5,
        # Found on the square and the lemniscate: a third fewer iterations than by default.
        "rho": 0.3,
        "alpha": 1.4,
        # Adapt the step size by iterations, never by the clock: two runs must agree.
        "adaptive_rho": 1,
        "adaptive_rho_interval": 10,
    }
    if soft:
        settings |= _SOFT_SETTINGS
    if math.isfinite(time_limit):  # it makes OSQP look at the clock in each iteration
        settings["time_limit"] = time_limit
    return settings
