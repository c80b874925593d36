# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""cvxpy as an oracle: the QP written down a second time, stage by stage, and solved elsewhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from peers import cvxpy as peers
from peers.controller import ControllerPeer

from quad_mpc_ros.control.config import MpcConfig, SolverParameters
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.mpc import FORMULATIONS
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP
from quad_mpc_ros.control.ocp.qp_solver import QpSolver
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation import closed_loop
from quad_mpc_ros.simulation.config import SimulatorConfig

cvxpy = pytest.importorskip("cvxpy", reason="the extra 'bench' is not installed")


@pytest.mark.parametrize("formulation", list(FORMULATIONS))
def test_both_write_down_the_same_problem(
    formulation: str, mpc: MpcConfig, odometries: list[OdometrySample], window: ReferenceWindow
) -> None:
    for odometry in odometries:
        model = FORMULATIONS[formulation](mpc)
        pattern = model.pattern()
        model.begin(DelayCompensation(mpc).predict(odometry), window)
        stages = model.linearise()
        problem, inputs, states = peers.stagewise_problem(cvxpy, stages, pattern)
        problem.solve(solver=cvxpy.CLARABEL)
        qp = HorizonQP(pattern)
        qp.update(stages)
        ours = QpSolver(qp, SolverParameters(tolerance=1e-7, max_iterations=20000)).solve()

        assert problem.status == cvxpy.OPTIMAL
        assert ours.solved
        scaled_inputs = ours.inputs / pattern.input_size
        np.testing.assert_allclose(inputs.value, scaled_inputs, atol=1e-3)
        np.testing.assert_allclose(states.value, ours.states / pattern.state_size, atol=1e-4)


def test_both_fly_the_same(
    mpc: MpcConfig, simulator: SimulatorConfig, reference: ReferenceConfig
) -> None:
    short = SimulatorConfig(dynamics=simulator.dynamics, duration=0.3, lockstep=True)
    flown = []
    for peer in (ControllerPeer(mpc), peers.CvxpyPeer(mpc, cvxpy)):
        steps = closed_loop.fly(simulator=short, reference=reference, controller=peer.step)
        commands = [step.command for step in steps]
        flown.append([[u.throttle, *u.w_WB_B] for u in commands if u is not None])
    ours, theirs = np.array(flown)

    assert len(theirs) == 15
    np.testing.assert_allclose(theirs[:, 0], ours[:, 0], atol=0.01)
    np.testing.assert_allclose(theirs[:, 1:], ours[:, 1:], atol=0.1)


def test_reports_a_solver_that_gives_up(
    mpc: MpcConfig, odometries: list[OdometrySample], window: ReferenceWindow
) -> None:
    hasty = dataclasses.replace(mpc, solver=SolverParameters(tolerance=1e-9, max_iterations=1))
    peer = peers.CvxpyPeer(hasty, cvxpy)

    with pytest.warns(UserWarning, match="inaccurate"):
        assert peer.step(odometries[0], window) is None
    assert not peer.effort().solved
