# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Before a run the command line warns of nodes that were given different vehicles."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from quad_mpc_ros.commands.run_configuration import run_configuration
from quad_mpc_ros.commands.run_options import add_run_options


def warned(*arguments: str, out: Path, capsys: pytest.CaptureFixture[str]) -> list[str]:
    parser = argparse.ArgumentParser()
    add_run_options(parser)
    run_configuration(parser.parse_args([*arguments, "--out", str(out)]), lockstep=True)
    return capsys.readouterr().err.splitlines()


@pytest.mark.parametrize("preset", ["default", "paper", "rotorpy", "vehicles/racer"])
def test_presets_define_equal_vehicles_for_all_nodes(
    preset: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if preset == "rotorpy":
        pytest.importorskip("rotorpy")
    assert warned("--config", preset, out=tmp_path / "run", capsys=capsys) == []


def test_each_node_that_differs_is_named_with_its_value(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ("--set", "simulator.mass=0.5", "--set", "reference.drag=0.3")
    assert warned(*settings, out=tmp_path / "run", capsys=capsys) == [
        "warning: the nodes have different vehicle parameters: mass 0.396893 of mpc and "
        "reference, 0.5 of simulator; drag 0.2 of mpc and simulator, 0.3 of reference",
    ]


def test_scaled_plant_parameters_are_not_a_vehicle_mismatch(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ("--set", "simulator.mass_scale=1.2", "--set", "simulator.thrust_scale=0.9")
    assert warned(*settings, out=tmp_path / "run", capsys=capsys) == []
