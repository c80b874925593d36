"""OSQP's compiled solver, called directly: the one file that uses what OSQP keeps to itself.

The Python layer of OSQP spends a quarter of a solve on copying results that nobody reads, and to
import it takes SciPy and Jinja with it: 15 MB, and a third of what a node imports. The tests
compare the two ways, with the oldest and the newest OSQP, and say what a new version lacks.
"""

from __future__ import annotations

import contextlib
import importlib.util
import sys
import types
from collections.abc import Callable, Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any, NamedTuple

from quad_mpc_ros.lie import Array
from quad_mpc_ros.ocp.sparse import SparseMatrix


def _extension() -> Any:
    """Return OSQP's compiled solver, of which there may be but one in a process."""
    name = "osqp.ext_builtin"
    package = importlib.util.find_spec("osqp")
    folders = package.submodule_search_locations if package is not None else None
    for folder in [] if name in sys.modules else folders or []:
        for suffix in EXTENSION_SUFFIXES:
            path = Path(folder, f"ext_builtin{suffix}")
            spec = importlib.util.spec_from_file_location(name, path) if path.exists() else None
            if spec is not None and spec.loader is not None:
                sys.modules[name] = module = importlib.util.module_from_spec(spec)
                spec.loader.exec_module(module)
                return module
    if name in sys.modules:
        return sys.modules[name]
    from osqp import ext_builtin  # wherever it may be

    return ext_builtin


class _StandIn(types.ModuleType):
    """What OSQP's compiled solver asks SciPy for: is a matrix of the one kind that it takes?

    Whoever else asks for SciPy meanwhile, in another thread, gets it.
    """

    def isspmatrix_csc(self, _: object) -> bool:
        """Return that it is."""
        return True

    def __getattr__(self, name: str) -> Any:
        _remove(self)
        return getattr(importlib.import_module(_SPARSE), name)


@contextlib.contextmanager
def _without_scipy() -> Iterator[None]:
    """Keep OSQP from importing SciPy, unless somebody has imported it."""
    stand_in = _StandIn(_SPARSE)
    sys.modules.setdefault(_SPARSE, stand_in)
    try:
        yield
    finally:
        _remove(stand_in)


def _remove(stand_in: _StandIn) -> None:
    if sys.modules.get(_SPARSE) is stand_in:
        del sys.modules[_SPARSE]


_SPARSE = "scipy.sparse"
_OSQP = _extension()
_STATUS = _OSQP.osqp_status_type
SOLVED = int(_STATUS.OSQP_SOLVED)
OUT_OF_TIME = int(_STATUS.OSQP_TIME_LIMIT_REACHED)
OUT_OF_ITERATIONS = int(_STATUS.OSQP_MAX_ITER_REACHED)


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
        P: SparseMatrix,
        q: Array,
        A: SparseMatrix,
        lower: Array,
        upper: Array,
        settings: dict[str, float],
    ) -> None:
        """Set up OSQP. ``P`` is the upper triangle; ``settings`` are OSQP's own, by its names."""
        chosen = _OSQP.OSQPSettings()
        _OSQP.osqp_set_default_settings(chosen)
        for name, value in settings.items():
            setattr(chosen, name, value)
        rows, columns = A.shape
        with _without_scipy():
            columnwise = _OSQP.CSC(P), _OSQP.CSC(A)
        self._solver = _OSQP.OSQPSolver(
            columnwise[0], q, columnwise[1], lower, upper, rows, columns, chosen
        )
        self._solver.update_rho(settings["rho"])  # as OSQP's own layer does
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
