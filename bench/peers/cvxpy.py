# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""cvxpy as a peer, as the paper uses it: the same QP, rebuilt at every step.

S. Diamond and S. Boyd, "CVXPY: A Python-embedded modeling language for convex optimization",
Journal of Machine Learning Research, 2016. Model, linearisation and what becomes of a solution
are this package's; the QP goes through cvxpy to the same solver with the same tolerance.
"""

from __future__ import annotations

import importlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from peers.peer import Effort, NewPeer, PeerKind, PeerUnavailableError, soft_limits_of

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.mpc import FORMULATIONS
from quad_mpc_ros.control.ocp.horizon_qp import HorizonPattern, HorizonStages


def cvxpy_module() -> Any:
    """Return cvxpy; raises :class:`PeerUnavailableError` when it is not installed."""
    try:
        return importlib.import_module("cvxpy")
    except ImportError as error:
        raise PeerUnavailableError(f"{error}: pip install 'quad_mpc_ros[bench]'") from error


class CvxpyPeer:
    """The controller of this package with its QP and its solver exchanged for cvxpy."""

    def __init__(self, config: MpcConfig, cvxpy: Any) -> None:
        self._config = config
        self._cvxpy = cvxpy
        self._delay_compensation = DelayCompensation(config)
        self._problem = FORMULATIONS[config.formulation](config)
        self._pattern = self._problem.pattern()
        if limits := soft_limits_of(config):
            name = f"{config.limits.owner}.{limits[0]}"
            raise PeerUnavailableError(f"the cvxpy peer has no {name}: --set {name}=0")
        self._effort = Effort(solved=False, iterations=0, solve_time=0.0)

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the first input of the plan; None when the solver failed."""
        self._problem.begin(self._delay_compensation.predict(odometry), window)
        self._effort = Effort(solved=True, iterations=0, solve_time=0.0)
        converged = False
        while not converged:
            solution = self._solve(self._problem.linearise())
            if solution is None:
                return None
            plan, converged = self._problem.line_search(*solution)
        u = plan.command_over(0.0, 1.0 / self._config.control_rate)
        self._delay_compensation.record(u, stamp_ns=odometry.stamp_ns)
        return CommandSample(stamp_ns=odometry.stamp_ns, throttle=u.throttle, w_WB_B=u.w_WB_B)

    def effort(self) -> Effort:
        """Return OSQP's iterations and run time, summed over the solves of the last step."""
        return self._effort

    def _solve(self, stages: HorizonStages) -> tuple[Array, Array] | None:
        """Return inputs (N, nu) and states 1 to N (N, nx), or None."""
        problem, inputs, states = stagewise_problem(self._cvxpy, stages, self._pattern)
        parameters = self._config.solver
        try:
            problem.solve(
                solver=self._cvxpy.OSQP,
                eps_abs=parameters.tolerance,
                eps_rel=parameters.tolerance,
                max_iter=parameters.max_iterations,
            )
        except self._cvxpy.error.SolverError:
            self._effort = Effort(solved=False, iterations=0, solve_time=0.0)
            return None
        stats = problem.solver_stats
        solved = problem.status == self._cvxpy.OPTIMAL
        self._effort = Effort(
            solved=solved,
            iterations=self._effort.iterations + int(stats.num_iters),
            solve_time=self._effort.solve_time + float(stats.solve_time),
        )
        if not solved:
            return None
        return (
            np.ascontiguousarray(inputs.value * self._pattern.input_size),
            np.ascontiguousarray(states.value * self._pattern.state_size),
        )


def stagewise_problem(
    cvxpy: Any, stages: HorizonStages, pattern: HorizonPattern
) -> tuple[Any, Any, Any]:
    """Return a horizon as a problem of cvxpy, with its inputs (N, nu) and states 1 to N (N, nx).

    The variables are divided by their natural size, as in
    :class:`~quad_mpc_ros.control.ocp.horizon_qp.HorizonQP`.
    """
    steps, sx, su = pattern.steps, pattern.state_size, pattern.input_size
    inputs = cvxpy.Variable((steps, len(su)))
    states = cvxpy.Variable((steps, len(sx)))
    H = np.broadcast_to(stages.H, (steps, len(sx), len(sx))) * np.outer(sx, sx)
    g = np.broadcast_to(stages.g * sx, (steps, len(sx)))
    R, r, lower, upper = (
        np.broadcast_to(part, (steps, len(su)))
        for part in (stages.R * su**2, stages.r * su, stages.lower / su, stages.upper / su)
    )
    A = stages.A * sx / sx[:, None]
    B = np.broadcast_to(stages.B * su / sx[:, None], (steps, len(sx), len(su)))
    cost, constraints, x = 0.0, [], stages.x0 / sx
    for i in range(steps):
        u, x_next = inputs[i], states[i]
        cost += 0.5 * cvxpy.quad_form(x_next, cvxpy.psd_wrap(H[i])) + g[i] @ x_next
        cost += 0.5 * cvxpy.sum(cvxpy.multiply(R[i], cvxpy.square(u))) + r[i] @ u
        constraints += [x_next == A[i] @ x + B[i] @ u, u >= lower[i], u <= upper[i]]
        x = x_next
    return cvxpy.Problem(cvxpy.Minimize(cost), constraints), inputs, states


def _made(config: MpcConfig, _: Path) -> NewPeer:
    return partial(CvxpyPeer, config, cvxpy_module())


PEER = PeerKind(
    title="the same QP through cvxpy, rebuilt each step",
    solver="OSQP",
    description="the same linearisation, solved with OSQP.",
    make=_made,
    package="cvxpy",
)
