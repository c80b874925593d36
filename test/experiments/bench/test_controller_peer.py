"""This controller in the comparison is the one that flies elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quad_mpc_ros.cli import main
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.experiments.bench import flights as bench_flight
from quad_mpc_ros.experiments.bench.controller import ControllerPeer
from quad_mpc_ros.experiments.bench.flights import (
    MeasuredFlight,
    errors_before_switches,
    summarise,
)
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation import closed_loop
from quad_mpc_ros.simulation.config import SimulatorConfig


@pytest.fixture(scope="module")
def flight(
    mpc: MpcConfig, simulator: SimulatorConfig, reference: ReferenceConfig
) -> MeasuredFlight:
    return bench_flight.fly(ControllerPeer(mpc), simulator=simulator, reference=reference)


def test_commands_are_those_of_the_closed_loop(
    flight: MeasuredFlight,
    mpc: MpcConfig,
    simulator: SimulatorConfig,
    reference: ReferenceConfig,
) -> None:
    elsewhere = [
        [step.tick.command.throttle, *step.tick.command.w_WB_B]
        for step in closed_loop.fly(mpc=mpc, simulator=simulator, reference=reference)
        if step.tick is not None and step.tick.command is not None
    ]

    assert len(elsewhere) == 75
    assert_array_equal(flight.commands, elsewhere)


def test_a_step_takes_longer_than_its_solver(flight: MeasuredFlight) -> None:
    assert flight.solved.all()
    assert np.all(flight.solve_us > 0.0)
    assert np.all(flight.mpc_us > flight.solve_us)
    assert np.all(flight.step_us > flight.mpc_us)


def test_figures_are_those_of_a_recorded_flight(tmp_path: Path) -> None:
    settings = {"mpc.formulation": "manifold", "reference.dwell_time": "0.5"}
    assignments = [f"--set={name}={value}" for name, value in settings.items()]
    out = tmp_path / "run"
    assert main(["simulate", "--duration", "1.2", *assignments, "--out", str(out)]) == 0
    recorded = json.loads((out / "summary.json").read_text())

    flown = bench_flight.fly(
        ControllerPeer(MpcConfig(formulation="manifold", lockstep=True)),
        simulator=SimulatorConfig(duration=1.2, lockstep=True),
        reference=ReferenceConfig(dwell_time=0.5, lockstep=True),
    )

    figures = summarise([flown])
    assert figures["position_rmse_m"] == pytest.approx(recorded["position_rmse_m"])
    assert errors_before_switches(flown) == pytest.approx(recorded["waypoint_error_m"][:2])
    assert figures["iterations"] == recorded["iterations"]
