"""A stand-in for OSQP that fails, lies or takes long on demand.

It replaces the adapter to OSQP and not the controller, so that the checks of the controller work.
"""

from __future__ import annotations

import enum
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.ocp import osqp_adapter
from quad_mpc_ros.control.ocp.osqp_adapter import OsqpAdapter, OsqpResult


class SolverFault(enum.Enum):
    """What the solver does instead of solving."""

    FAIL = "fail"  # it reaches its limit of iterations
    LIE = "lie"  # it reports "solved" with NaN
    RUN_LONG = "run_long"  # it solves, but not in time


class FaultySolver:
    """Replaces OSQP while :meth:`installed`; ``fault`` may change at any time."""

    def __init__(self) -> None:
        self.fault: SolverFault | None = None
        self.long = 0.03
        """Duration of a solve that runs long [s]."""

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Let solvers that are set up from now on be faulty on demand."""
        faults = self

        class Faulty(OsqpAdapter):
            def solve(self, x: Array, y: Array) -> OsqpResult:
                if faults.fault is SolverFault.RUN_LONG:
                    time.sleep(faults.long)
                return faults._with_fault(super().solve(x, y))

        original, osqp_adapter.set_up = osqp_adapter.set_up, Faulty
        try:
            yield
        finally:
            osqp_adapter.set_up = original

    def _with_fault(self, result: OsqpResult) -> OsqpResult:
        """Return a result as the present fault changes it."""
        match self.fault:
            case SolverFault.FAIL:
                return result._replace(
                    status=osqp_adapter.OUT_OF_ITERATIONS, status_text="maximum iterations reached"
                )
            case SolverFault.LIE:
                return result._replace(x=np.full_like(result.x, np.nan))
            case _:
                return result
