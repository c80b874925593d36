"""The adapter gives what OSQP itself gives, set up once and updated."""

from __future__ import annotations

import os
import signal
import threading

import numpy as np
import osqp
import pytest
from numpy.testing import assert_array_equal
from scipy import sparse

from quad_mpc_ros.control.config import SolverParameters
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP
from quad_mpc_ros.control.ocp.osqp_adapter import OsqpAdapter
from quad_mpc_ros.control.ocp.qp_solver import QpSolver
from quad_mpc_ros.control.ocp.stages import HorizonPattern, HorizonStages


def test_solves_as_osqp_does(
    flown_pattern: HorizonPattern, flown_problems: list[HorizonStages]
) -> None:
    """With the settings that were found for these problems, over a few ticks of a flight."""
    stages = flown_problems[100:106]
    qp = HorizonQP(flown_pattern)
    qp.update(stages[0])
    solver = QpSolver(qp, SolverParameters())
    solver.solve()
    reference = osqp.OSQP()
    reference.setup(
        P=qp.P, q=qp.q, A=qp.A, l=qp.lower, u=qp.upper, verbose=False,
        eps_abs=1e-3, eps_rel=1e-3, max_iter=400, scaling=1,
        check_termination=5, rho=0.3, alpha=1.4,
        adaptive_rho=1, adaptive_rho_interval=10,
    )  # fmt: skip
    expected = reference.solve(raise_error=False)
    for horizon in stages[1:]:
        qp.update(horizon)
        found = solver.solve()
        reference.update(q=qp.q, l=qp.lower, u=qp.upper, Px=qp.P.data, Ax=qp.A.data)
        reference.warm_start(x=expected.x, y=expected.y)
        expected = reference.solve(raise_error=False)
        assert_array_equal(found.z, expected.x)
        assert found.iterations == expected.info.iter
        assert found.primal_residual == expected.info.prim_res
        assert found.dual_residual == expected.info.dual_res
        assert found.status == expected.info.status


def test_ctrl_c_while_osqp_solves_is_not_lost() -> None:
    size, random = 300, np.random.default_rng(0)
    adapter = OsqpAdapter(
        P=sparse.csc_matrix(sparse.eye(size)),
        q=random.normal(size=size),
        A=sparse.csc_matrix(random.normal(size=(size, size))),
        lower=-np.ones(size),
        upper=np.ones(size),
        settings={"verbose": False, "eps_abs": 1e-99, "eps_rel": 0.0, "max_iter": 10**7},
    )
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    ctrl_c = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    try:
        ctrl_c.start()
        with pytest.raises(KeyboardInterrupt):
            adapter.solve(np.zeros(size), np.zeros(size))
    finally:
        ctrl_c.join()
        signal.signal(signal.SIGINT, before)
