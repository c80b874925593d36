# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""OSQP, set up once for a pattern: updates in place, warm starts, checks of solutions."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import osqp

from quad_mpc_ros.control.config import SolverParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP, read, warm_start

new_osqp: Callable[[], Any] = osqp.OSQP
"""Factory for OSQP instances; tests replace it to inject failures."""

_SOLVED = int(osqp.SolverStatus.OSQP_SOLVED)
# Out of iterations, within ten times the tolerance.
_SOLVED_INACCURATE = int(osqp.SolverStatus.OSQP_SOLVED_INACCURATE)
_OUT_OF_TIME = int(osqp.SolverStatus.OSQP_TIME_LIMIT_REACHED)
_INTERRUPTED = int(osqp.SolverStatus.OSQP_SIGINT)


class QpSolution(NamedTuple):
    """The solver's result, to be used only when ``solved``.

    ``z`` are the scaled variables of the solver, ``inputs`` (N, nu) and ``states`` 1 to N (N, nx)
    are in physical units. Residuals refer to the scaled problem, ``solve_time`` is OSQP's solve
    time in seconds.
    """

    solved: bool
    status: str
    z: Array = np.zeros(0)
    inputs: Array = np.zeros((0, 0))
    states: Array = np.zeros((0, 0))
    iterations: int = 0
    primal_residual: float = 0.0
    dual_residual: float = 0.0
    solve_time: float = 0.0


_LARGEST = 1e15  # OSQP takes larger numbers for infinite
_REFUSED = QpSolution(solved=False, status="not finite or too large")


class QpSolver:
    """Solves a :class:`HorizonQP` repeatedly, each time from the previous solution."""

    def __init__(
        self,
        qp: HorizonQP,
        parameters: SolverParameters,
        *,
        time_limit: float = math.inf,
        progress: bool = False,
        half_spaces: bool = False,
    ) -> None:
        """``time_limit`` [s] stops a solve that takes longer.

        ``progress`` along the reference is among the variables, or ``half_spaces`` are among the
        soft rows; not both.
        """
        self._qp, self._progress = qp, progress
        # With soft rows the solution is a step, of which a line search takes as much as lowers
        # the true cost, so a less accurate one is of use as well. Without, it is the plan itself.
        self._accepted = {_SOLVED, _SOLVED_INACCURATE} if qp.is_soft else {_SOLVED}
        self._settings = _settings(parameters, time_limit, soft=qp.is_soft)
        if half_spaces:
            self._settings |= _HALF_SPACE_SETTINGS
        if progress:
            self._settings |= _PROGRESS_SETTINGS
        self._osqp: Any = None
        self._z = self._zero = np.zeros(qp.A.shape[1])
        self._y = np.zeros(qp.A.shape[0])
        self._multipliers = np.zeros(qp.A.shape[0])
        n, nx, nu, *_ = qp.pattern.sizes
        self._shapes = (n, nu), (n, nx)  # of inputs and states

    def solve(self, *, from_zero: bool = False, again: bool = False) -> QpSolution:
        """Solve the current problem of the QP, warm started in primal and dual.

        ``from_zero`` starts the primal at zero, for problems in deviations from a known plan.
        ``again`` means that the last problem was linearised about another plan.
        """
        # Given NaN, OSQP keeps its old data or reports "solved", so refuse it here. The comparison
        # is false for NaN.
        if not self._qp.magnitude < _LARGEST:
            self.forget()
            return _REFUSED
        qp, z, y = self._qp, self._zero if from_zero else self._z, self._y
        if qp.is_soft:
            if again and self._progress:
                y[qp.first_soft_row :] = 0.0
            warm_start(z, y, self._multipliers, qp.cost_scale, qp.scales, qp.numbers)
            y = self._multipliers
        result = self._solved_from(z, y)
        info = result.info
        # A solver may report "solved" and return NaN; the plan is what flies, so check the plan.
        inputs, states = np.empty(self._shapes[0]), np.empty(self._shapes[1])
        finite = read(result.x, result.y, qp.cost_scale, qp.scales, inputs, states)
        solved = finite and info.status_val in self._accepted
        if solved or (finite and info.status_val == _OUT_OF_TIME):
            self._z, self._y = result.x, result.y  # keep the progress made for the next solve
        else:
            self.forget()
        return QpSolution(
            solved=solved,
            status=info.status if finite else "not finite",
            z=self._z,
            inputs=inputs,
            states=states,
            iterations=info.iter,
            primal_residual=info.prim_res,
            dual_residual=info.dual_res,
            solve_time=info.run_time,
        )

    def forget(self) -> None:
        """Start the next solve from zero: after a failure the old iterate does not help."""
        self._z = np.zeros_like(self._z)
        self._y = np.zeros_like(self._y)

    def _solved_from(self, z: Array, y: Array) -> Any:
        """Return OSQP's result, with new arrays ``x`` and ``y``, from a start.

        OSQP itself handles SIGINT during a solve. The signal is raised again, so that Ctrl-C is
        not lost.
        """
        qp = self._qp
        if self._osqp is None:
            self._osqp = new_osqp()
            self._osqp.setup(P=qp.P, q=qp.q, A=qp.A, l=qp.lower, u=qp.upper, **self._settings)
        else:
            self._osqp.update(q=qp.q, l=qp.lower, u=qp.upper, Px=qp.P.data, Ax=qp.A.data)
        self._osqp.warm_start(x=z, y=y)
        result = self._osqp.solve(raise_error=False)
        if result.info.status_val == _INTERRUPTED:
            signal.raise_signal(signal.SIGINT)
        return result


# Settings with soft rows, found on jumps and on random states and limits: half the iterations.
_SOFT_SETTINGS = {"scaling": 1, "rho": 0.7, "alpha": 1.6}
# Their cost is divided by its steepest slope, so that the tolerance is a share of that.
_SOFT_TOLERANCE = 2.0
# With half-spaces, found on flights among pillars, where the local path jumps. A step size
# adapted earlier than by default oscillated until a solve failed.
_HALF_SPACE_SETTINGS = {"alpha": 1.7, "scaling": 6, "rho": 0.5}

# With progress, whose curvature is small and changes with the speed of the reference, the step
# size is adapted where it is off by 1.7 times, not by five: a quarter off the iterations of the
# slowest hundredth of random problems without soft rows, a tenth with. Soft rows of the tilt turn
# from one linearisation to the next, and begin again without multipliers: a fifth off. Not with
# half-spaces.
_PROGRESS_SETTINGS = {"adaptive_rho_tolerance": 1.7}


def _settings(parameters: SolverParameters, time_limit: float, *, soft: bool) -> dict[str, float]:
    """Return OSQP's settings, for problems with or without soft rows."""
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
