# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""acados as an oracle: another model, another integrator, another solver, the same optimum."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.planner import Planner
from peers import acados
from peers.controller import ControllerPeer
from peers.peer import PeerUnavailableError
from performance import fly, summarise

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation import closed_loop
from quad_mpc_ros.simulation.config import SimulatorConfig

_ITERATIONS = 40


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("acados", reason="the extra 'bench' is not installed")
    for tool in ("gcc", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"acados compiles its solver, and there is no {tool}")
    return tmp_path_factory.mktemp("acados")


@pytest.fixture(scope="module")
def solver(folder: Path, mpc: MpcConfig) -> Any:
    """Return the solver of the peer, one real-time iteration a call."""
    return acados.build_solver(mpc, folder / "peer")


def converged_inputs(mpc: MpcConfig, odometry: OdometrySample, window: ReferenceWindow) -> Array:
    """Return the inputs, stage by stage, that iterations at one and the same state come to."""
    controller = Planner(mpc)
    for _ in range(_ITERATIONS):
        plan = controller.step(odometry, window).plan
        assert plan is not None
    return np.asarray(plan.inputs.reshape(mpc.horizon_steps, -1, 4).mean(axis=1))


def test_both_converge_to_the_same_plan(
    folder: Path, mpc: MpcConfig, odometries: list[OdometrySample], window: ReferenceWindow
) -> None:
    exact = dataclasses.replace(mpc, solver=dataclasses.replace(mpc.solver, tolerance=1e-6))
    to_the_end = acados.build_solver(mpc, folder / "converging", converge=True)
    for odometry in odometries:
        peer = acados.AcadosPeer(mpc, to_the_end)
        assert peer.step(odometry, window) is not None

        difference = np.abs(peer.inputs() - converged_inputs(exact, odometry, window))
        assert np.all(difference < [0.005, 0.05, 0.05, 0.05])


def test_both_fly_the_same_square(
    solver: Any, mpc: MpcConfig, simulator: SimulatorConfig, reference: ReferenceConfig
) -> None:
    config = FlightConfig(mpc, simulator, reference)
    theirs = fly(acados.AcadosPeer(mpc, solver), config)
    again = fly(acados.AcadosPeer(mpc, solver), config)
    ours = fly(ControllerPeer(mpc), config)

    assert theirs.solved.all()
    assert np.all((theirs.solve_us > 0.0) & (theirs.solve_us < theirs.step_us))
    np.testing.assert_array_equal(theirs.errors, again.errors)
    rmse = [summarise([flight])["position_rmse_m"] for flight in (theirs, ours)]
    assert rmse[0] == pytest.approx(rmse[1], rel=0.02)


def test_rejects_parameters_that_its_model_lacks(tmp_path: Path, mpc: MpcConfig) -> None:
    lagging = dataclasses.replace(mpc, rate_time_constant=0.03)
    with pytest.raises(PeerUnavailableError, match="rate_time_constant"):
        acados.build_solver(lagging, tmp_path)


def test_both_apply_a_soft_tilt_limit(
    folder: Path, mpc: MpcConfig, simulator: SimulatorConfig, reference: ReferenceConfig
) -> None:
    """Theirs is a square about the disc of tilts, which is wider at its corners."""
    limited = mpc.updated({"limits.tilt_max": 0.5, "limits.speed_max": 3.0})
    theirs = acados.AcadosPeer(limited, acados.build_solver(limited, folder / "limited"))
    corner = np.arcsin(np.sqrt(2.0) * np.sin(0.5))
    mean_errors = []
    for peer, tilt in ((theirs, corner), (ControllerPeer(limited), 0.5)):
        steps = list(
            closed_loop.fly(simulator=simulator, reference=reference, controller=peer.step)
        )
        assert all(step.command is not None for step in steps)
        assert np.arccos(min(step.truth.up for step in steps)) < tilt + 0.05
        assert max(step.truth.speed for step in steps) < 3.2
        errors = [np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]) for step in steps]
        mean_errors.append(float(np.mean(errors)))
    assert mean_errors[0] == pytest.approx(mean_errors[1], rel=0.2)
