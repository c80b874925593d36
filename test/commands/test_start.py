# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``--start``: where a flight begins."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest
from fixtures.plant_motion import integrate
from numpy.testing import assert_allclose

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.run_configuration import RunConfig, run_configuration
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.simulation.config import SimulatorConfig


def resolved(out: Path, *arguments: str) -> RunConfig:
    parser = argparse.ArgumentParser()
    add_run_options(parser)
    return run_configuration(parser.parse_args([*arguments, "--out", str(out)]), lockstep=True)


def start_of(simulator: SimulatorConfig) -> dict[str, object]:
    names = ("position", "velocity", "attitude", "body_rates", "throttle")
    return {name: getattr(simulator, f"initial_{name}") for name in names}


ON_THE_GROUND = start_of(SimulatorConfig())


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--config", "paper"],
        ["--start", "ground"],
        ["--reference", "lemniscate", "--start", "ground"],
        ["--reference", "hover", "--start", "ground"],
    ],
)
def test_starts_on_the_ground(arguments: list[str], tmp_path: Path) -> None:
    assert start_of(resolved(tmp_path, *arguments).simulator) == ON_THE_GROUND


@pytest.mark.parametrize(
    "arguments", [["--reference", "hover"], ["--reference", "square"], ["--config", "paper"]]
)
def test_starts_at_rest_on_a_reference_at_rest(arguments: list[str], tmp_path: Path) -> None:
    run = resolved(tmp_path, *arguments, "--start", "reference")
    assert start_of(run.simulator) == {
        **ON_THE_GROUND,
        "position": (0.0, 0.0, 2.0),
        "throttle": pytest.approx(0.2923008, abs=1e-7),
    }


@pytest.mark.parametrize(
    "arguments",
    [
        ["--reference", "lemniscate"],
        ["--set", "reference.trajectory=lemniscate"],
        ["--config", "paper", "--reference", "lemniscate", "--set", "simulator.mass_scale=1.2"],
        ["--reference", "lemniscate", "--set", "reference.angular_frequency=2.6"],
        ["--reference", "lemniscate", "--set", "reference.origin=[5, -7]"],
    ],
)
def test_start_in_motion_stays_on_a_smooth_reference(arguments: list[str], tmp_path: Path) -> None:
    run = resolved(tmp_path, *arguments)
    simulator, trajectory = run.simulator, configured_trajectory(run.reference)
    R_WB = so3.rotation_from_quaternion_xyzw(simulator.initial_attitude)
    x = State(
        p_WB=np.array(simulator.initial_position),
        v_WB_B=R_WB.T @ simulator.initial_velocity,
        R_WB=R_WB,
    )
    u = Input(throttle=simulator.initial_throttle, w_WB_B=np.array(simulator.initial_body_rates))

    # The true vehicle follows it for a while by this input alone.
    after = integrate(x, u, simulator.vehicle(), duration=0.02)

    expected = trajectory.at([20_000_000])
    assert_allclose(x.p_WB, trajectory.at([0]).p_WB[0], rtol=1e-12)
    assert_allclose(after.p_WB, expected.p_WB[0], atol=1e-4)
    assert_allclose(after.v_WB_W, expected.v_WB_W[0], atol=1e-2)
    R_after = so3.rotation_from_quaternion_xyzw(expected.q_WB_xyzw[0])
    assert_allclose(so3.log(R_after.T @ after.R_WB), np.zeros(3), atol=1e-2)


def test_explicit_settings_win_over_the_start(tmp_path: Path) -> None:
    arguments = ["--reference", "lemniscate", "--start", "reference"]
    untouched = start_of(resolved(tmp_path, *arguments).simulator)

    changes = ["--set", "simulator.initial_position=[1, 2, 3]"]
    changed = start_of(resolved(tmp_path, *arguments, *changes).simulator)

    assert changed == {**untouched, "position": (1.0, 2.0, 3.0)}
    assert untouched["velocity"] == (3.0, 3.0, 0.0)


MISTAKES = {
    # It can hover, but not hold itself against the drag of 11 m/s as well.
    "no throttle for it": (
        ["--set", "reference.angular_frequency=2.6", "--set", "simulator.mass_scale=4.737"],
        ["--start reference", "the thrust at a throttle in [0, 1]", "--start ground"],
    ),
    "no vehicle can fly it": (
        ["--set", "reference.angular_frequency=3"],
        ["reference.trajectory", "lemniscate", "throttle", "beyond the limit of 1"],
    ),
    "one coordinate too many": (
        ["--set", "reference.origin=[0, 0, 2]"],
        ["reference.origin", "2 numbers"],
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_exit_code_2(
    mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, message = MISTAKES[mistake]
    out = tmp_path / "run"

    assert main(["simulate", "--reference", "lemniscate", *arguments, "--out", str(out)]) == 2

    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1
    for word in message:
        assert word in error
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "duration"),
    [
        (["--reference", "hover"], 10.0),
        (["--reference", "square"], 10.0),  # 8 s
        (["--reference", "excitation"], 22.0),
        (["--gates", "seven_gates", "--duration", "4"], 4.0),
        (["--reference", "excitation", "--set", "simulator.duration=3"], 3.0),
    ],
)
def test_default_duration_is_one_lap_and_two_seconds(
    arguments: list[str], duration: float, tmp_path: Path
) -> None:
    assert resolved(tmp_path, *arguments).simulator.duration == duration


def test_lasts_as_long_as_the_course_of_gates(tmp_path: Path) -> None:
    run = resolved(tmp_path, "--gates", "seven_gates")
    assert run.simulator.duration == 1e-9 * run.trajectory.period_ns + 2.0 > 10.0
    contouring = ["--set", "mpc.formulation=contouring"]
    later = resolved(tmp_path / "contouring", "--gates", "seven_gates", *contouring)
    assert later.simulator.duration > 1.2 * 1e-9 * run.trajectory.period_ns
