# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``rotorpy``: commands have the same meaning as in other plants."""

from __future__ import annotations

import argparse
import importlib
import json
import math
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands import simulate
from quad_mpc_ros.commands.run_configuration import SCHEMA, run_configuration
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import DelayedPlant

MILLISECOND = 1_000_000
SECOND = 1_000_000_000


def configured(**changes: Any) -> SimulatorConfig:
    config = cast(SimulatorConfig, files.load(["rotorpy"], [], schema=SCHEMA)["simulator"])
    start = {"initial_position": (0.0, 0.0, 50.0), "initial_throttle": hover_throttle(config)}
    return config.updated({**start, **changes})


def hover_throttle(config: SimulatorConfig) -> float:
    return config.vehicle().hover_throttle


@pytest.fixture
def rotorpy() -> None:
    pytest.importorskip("rotorpy.vehicles.multirotor")


def plant(**changes: Any) -> DelayedPlant:
    return make_plant(configured(**changes))


def commanded(
    body: DelayedPlant, throttle: float, rates: tuple[float, float, float]
) -> DelayedPlant:
    body.apply(CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(rates)))
    return body


def test_reports_missing_rotorpy_with_the_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named '{name.split('.')[0]}'")

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(UserError, match=r"rotorpy.*pip install 'quad_mpc_ros\[rotorpy\]'$") as e:
        make_plant(SimulatorConfig(plant="rotorpy"))
    assert "\n" not in str(e.value)


@pytest.mark.usefixtures("rotorpy")
def test_preset_matches_the_hummingbird_of_rotorpy() -> None:
    from rotorpy.vehicles.hummingbird_params import quad_params

    loaded = files.load(["rotorpy"], [], schema=SCHEMA)
    mpc, simulator = cast(MpcConfig, loaded["mpc"]), configured()
    strongest = quad_params["k_eta"] * quad_params["rotor_speed_max"] ** 2
    rotors = quad_params["num_rotors"]
    hover = math.sqrt(mpc.mass * mpc.gravity / (rotors * quad_params["k_eta"]))  # rad/s
    along, across = (rotors * quad_params[k] * hover / mpc.mass for k in ("k_d", "k_z"))
    lift = rotors * quad_params["k_h"] / mpc.mass
    for vehicle in (mpc, simulator):
        assert_allclose(vehicle.rotor_drag, [along, along, across], rtol=1e-3)
        assert_allclose(vehicle.translational_lift, lift, rtol=1e-3)
        assert vehicle.mass == quad_params["mass"]
        assert vehicle.motor_count == quad_params["num_rotors"]
        assert_allclose(vehicle.thrust_curve, [strongest, 0.0, 0.0], rtol=1e-12)
    assert mpc.thrust_time_constant == quad_params["tau_m"]
    assert mpc.rate_time_constant == 1.0 / simulator.rotorpy_rate_gain


@pytest.mark.usefixtures("rotorpy")
def test_hovers_at_the_hover_throttle() -> None:
    body = plant()
    body.advance_to(SECOND // 2)
    assert_allclose(body.state.p_WB, [0.0, 0.0, 50.0], atol=1e-6)
    assert_allclose(body.state.v_WB_B, np.zeros(3), atol=1e-6)


@pytest.mark.usefixtures("rotorpy")
def test_nose_down_accelerates_forwards_at_any_heading() -> None:
    north = tuple(Rotation.from_euler("z", math.pi / 2.0).as_quat())
    body = plant(initial_attitude=north)
    commanded(body, hover_throttle(configured()), (0.0, 1.0, 0.0)).advance_to(400 * MILLISECOND)
    assert body.state.v_WB_W[1] > 0.3
    assert body.state.v_WB_B[0] > 0.3
    assert abs(body.state.v_WB_W[0]) < 1e-6
    odometry = body.odometry(7)
    assert odometry.stamp_ns == 7
    assert np.linalg.norm(odometry.q_WB_xyzw) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.usefixtures("rotorpy")
def test_starts_in_the_configured_motion() -> None:
    q = tuple(Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_quat())
    body = plant(
        initial_velocity=(1.0, 2.0, -3.0), initial_attitude=q, initial_body_rates=(0.1, -0.2, 0.3)
    )
    assert_allclose(body.state.v_WB_W, [1.0, 2.0, -3.0], atol=1e-12)
    assert_allclose(body.state.R_WB, Rotation.from_quat(q).as_matrix(), atol=1e-12)
    assert_array_equal(body.odometry(0).w_WB_B, [0.1, -0.2, 0.3])


@pytest.mark.usefixtures("rotorpy")
def test_wind_and_weight_act() -> None:
    windy, heavy = plant(wind=(5.0, 0.0, 0.0)), plant(mass_scale=1.2)
    for body in (windy, heavy):
        body.advance_to(200 * MILLISECOND)
    assert windy.state.v_WB_W[0] == pytest.approx(0.2 * 0.47 * 5.0, rel=0.15)
    assert heavy.state.v_WB_W[2] == pytest.approx(-0.2 * 9.81 * (1.0 - 1.0 / 1.2), rel=0.15)


@pytest.mark.usefixtures("rotorpy")
def test_takes_off_from_the_ground() -> None:
    body = plant(initial_position=(0.0, 0.0, 0.0), initial_throttle=0.0)
    body.advance_to(100 * MILLISECOND)
    assert_allclose(body.state.p_WB, np.zeros(3), atol=2e-3)
    commanded(body, 0.5, (0.0, 0.0, 0.0)).advance_to(400 * MILLISECOND)
    assert body.state.p_WB[2] > 0.1


@pytest.mark.slow
@pytest.mark.usefixtures("rotorpy")
@pytest.mark.parametrize(
    ("reference", "wind", "rmse"),
    [("lemniscate", 0.0, 0.01), ("lemniscate", 5.0, 0.05)],
)
def test_the_mpc_flies_the_plant(reference: str, wind: float, rmse: float, tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = ["--plant", "rotorpy", "--reference", reference, "--set"]
    options += [f"simulator.wind=[{wind}, 0.0, 0.0]", "--duration", "8", "--out", str(out)]
    assert main(["simulate", *options]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["position_rmse_m"] <= rmse
    assert summary["solver_failures"] == 0
    assert summary["config"]["simulator"]["plant"] == "rotorpy"


@pytest.mark.usefixtures("rotorpy")
def test_files_and_assignments_override_the_preset_of_the_plant(tmp_path: Path) -> None:
    heavier = tmp_path / "heavier.yaml"
    heavier.write_text("mpc:\n  ros__parameters:\n    mass: 0.6\n    drag: 0.3\n")
    parser = argparse.ArgumentParser()
    simulate.add_options(parser)
    arguments = ["--plant", "rotorpy", "--config", str(heavier), "--set", "mpc.drag=0.4"]
    arguments += ["--out", str(tmp_path / "run")]
    run = run_configuration(parser.parse_args(arguments), lockstep=True)
    assert (run.mpc.mass, run.mpc.drag, run.mpc.motor_count) == (0.6, 0.4, 4)
    assert run.mpc.thrust_curve == run.simulator.thrust_curve == run.reference.thrust_curve
    assert run.simulator.plant == "rotorpy"


@pytest.mark.parametrize("command", ["simulate", "fly"])
def test_reports_a_missing_plant_before_anything_is_written(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "rotorpy.vehicles.multirotor", None)
    out = tmp_path / "run"
    assert main([command, "--config", "rotorpy", "--out", str(out)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert "pip install 'quad_mpc_ros[rotorpy]'" in lines[0]
    assert not out.exists()
