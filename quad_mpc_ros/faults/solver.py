"""A stand-in for OSQP that fails, lies or takes long on demand.

It is put in OSQP's place and not into the controller, whose own checks are to be seen working.
"""

from __future__ import annotations

import enum
import functools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import osqp

_FAILED: dict[str, Any] = {
    "status_val": osqp.SolverStatus.OSQP_MAX_ITER_REACHED,
    "status": "maximum iterations reached",
}


class SolverFault(enum.Enum):
    """What the solver does instead of solving."""

    FAIL = "fail"  # it reaches its limit of iterations
    LIE = "lie"  # it says "solved" of numbers that are none
    RUN_LONG = "run_long"  # it solves, but not in time


class FaultySolver:
    """Replaces OSQP while :meth:`installed`; ``fault`` may change at any time."""

    def __init__(self) -> None:
        self.fault: SolverFault | None = None
        self.long = 0.03
        """How many seconds a solve takes that runs long."""

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Let solvers that are set up from now on be faulty on demand."""
        original = osqp.OSQP
        osqp.OSQP = functools.partial(_FaultyOsqp, original, self)
        try:
            yield
        finally:
            osqp.OSQP = original


class _FaultyOsqp:
    """OSQP but for its compiled solver."""

    def __init__(self, original: Any, faults: FaultySolver) -> None:
        self._osqp, self._faults = original(), faults
        self._solver: Any = None

    def setup(self, *arguments: Any, **settings: Any) -> Any:
        outcome = self._osqp.setup(*arguments, **settings)
        self._solver = _Compiled(self._osqp._solver, self._faults)
        return outcome

    def __getattr__(self, name: str) -> Any:
        return getattr(self._osqp, name)


class _Compiled:
    """OSQP's compiled solver but for the fault."""

    def __init__(self, solver: Any, faults: FaultySolver) -> None:
        self._solver, self._faults = solver, faults

    def solve(self) -> Any:
        if self._faults.fault is SolverFault.RUN_LONG:
            time.sleep(self._faults.long)
        return self._solver.solve()

    @property
    def info(self) -> Any:
        return _Info(self._solver.info, self._faults)

    @property
    def solution(self) -> Any:
        return _Solution(self._solver.solution, self._faults)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._solver, name)


class _Info:
    """What OSQP tells of a solve, but for the fault of the moment: it is fetched once for all."""

    def __init__(self, info: Any, faults: FaultySolver) -> None:
        self._info, self._faults = info, faults

    def __getattr__(self, name: str) -> Any:
        if self._faults.fault is SolverFault.FAIL and name in _FAILED:
            return _FAILED[name]
        return getattr(self._info, name)


class _Solution:
    """OSQP's solution but for the fault of the moment."""

    def __init__(self, solution: Any, faults: FaultySolver) -> None:
        self._solution, self._faults = solution, faults

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._solution, name)
        lies = self._faults.fault is SolverFault.LIE and name == "x"
        return np.full_like(value, np.nan) if lies else value
