"""What OSQP keeps to itself is still there, and does what its public interface does."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import osqp
import pytest
from numpy.testing import assert_array_equal

from quad_mpc_ros.control.config import SolverParameters
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP
from quad_mpc_ros.control.ocp.qp_solver import QpSolver
from quad_mpc_ros.control.ocp.stages import HorizonPattern, HorizonStages


@pytest.fixture(scope="module")
def stages(flown_problems: list[HorizonStages]) -> list[HorizonStages]:
    """Return the horizons of a few ticks of the paper's flight."""
    return flown_problems[100:106]


@pytest.fixture
def qp(flown_pattern: HorizonPattern, stages: list[HorizonStages]) -> HorizonQP:
    """Return the problem of the first of them."""
    qp = HorizonQP(flown_pattern)
    qp.update(stages[0])
    return qp


def test_the_compiled_solver_has_what_the_adapter_calls(qp: HorizonQP) -> None:
    public = osqp.OSQP()
    public.setup(P=qp.P, q=qp.q, A=qp.A, l=qp.lower, u=qp.upper, verbose=False)
    public.solve(raise_error=False)
    needed = {
        "_solver": ("update_data_vec", "update_data_mat", "warm_start", "solve"),
        "_solver.info": ("status_val", "status", "iter", "prim_res", "dual_res", "run_time"),
        "_solver.solution": ("x", "y"),
    }
    for owner, names in needed.items():
        for name in names:
            held = public
            for step in f"{owner}.{name}".split("."):
                assert hasattr(held, step), (
                    f"OSQP {version('osqp')} has no {owner}.{name} any more, which "
                    "quad_mpc_ros/control/ocp/osqp_adapter.py uses"
                )
                held = getattr(held, step)


def test_the_public_interface_of_osqp_gives_the_same(
    qp: HorizonQP, stages: list[HorizonStages]
) -> None:
    """What is called directly is what its Python layer calls."""
    solver = QpSolver(qp, SolverParameters())
    solver.solve()
    public = osqp.OSQP()
    public.setup(
        P=qp.P, q=qp.q, A=qp.A, l=qp.lower, u=qp.upper, verbose=False,
        eps_abs=1e-3, eps_rel=1e-3, max_iter=400, scaling=1,
        check_termination=5, rho=0.3, alpha=1.4,
        adaptive_rho=1, adaptive_rho_interval=10,
    )  # fmt: skip
    first = public.solve(raise_error=False)
    for horizon in stages[1:]:
        qp.update(horizon)
        found = solver.solve()
        public.update(q=qp.q, l=qp.lower, u=qp.upper, Px=qp.P.data, Ax=qp.A.data)
        public.warm_start(x=first.x, y=first.y)
        first = public.solve(raise_error=False)
        assert_array_equal(found.z, first.x)
        assert found.iterations == first.info.iter
        assert found.primal_residual == first.info.prim_res
        assert found.dual_residual == first.info.dual_res
        assert found.status == first.info.status


def test_a_controller_does_without_what_osqp_imports() -> None:
    """And OSQP itself may be imported after it. An old SciPy's linear algebra brings the rest."""
    code = (
        "import sys\n"
        "import scipy.linalg\n"
        "there = {*sys.modules}\n"
        "from quad_mpc_ros.control.warm_up import warmed_up\n"
        "from quad_mpc_ros.control.config import MpcConfig\n"
        "warmed_up(MpcConfig())\n"
        "print(*{'scipy.sparse', 'jinja2', 'osqp.interface'} & (sys.modules.keys() - there))\n"
        "from quad_mpc_ros.control.ocp import osqp_adapter\n"
        "import osqp\n"
        "assert osqp.SolverStatus.OSQP_SOLVED == osqp_adapter.SOLVED\n"
        "assert osqp.OSQP().ext is sys.modules['osqp.ext_builtin']\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip() == ""


def test_scipy_is_itself_for_whoever_asks_while_a_problem_is_set_up() -> None:
    code = (
        "import sys\n"
        "from quad_mpc_ros.control.ocp import osqp_adapter\n"
        "with osqp_adapter._without_scipy():\n"
        "    assert not isinstance(sys.modules['scipy.sparse'].__doc__, str)\n"
        "    from scipy.sparse.linalg import splu\n"
        "    from scipy import sparse\n"
        "assert sparse.csc_matrix((2, 2)).nnz == 0\n"
        "assert sys.modules['scipy.sparse'] is sparse\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
