# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A user's mistake: one line that names it, exit code 2, nothing written over."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from quad_mpc_ros.cli import main

MISTAKES = {
    "unknown node": (["--set", "mpcc.mass=1"], ["mpcc", "mpc, simulator, reference, recorder"]),
    "unknown preset": (["--config", "papper"], ["papper", "paper", "default"]),
    "too heavy": (["--set", "mpc.mass=5"], ["mass", "5", "weight"]),
    "throttle bounds": (["--set", "mpc.throttle_max=0.2"], ["throttle_max", "0.2", "0.2923"]),
}
"""Mistakes that the tests of every option and of every parameter do not make."""


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_exit_code_2(
    mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, message = MISTAKES[mistake]
    out = tmp_path / "run"

    assert main(["simulate", *arguments, "--out", str(out)]) == 2

    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    for word in message:
        assert word in printed.err
    assert not out.exists()


def test_unknown_plant_is_refused_with_the_known_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["simulate", "--plant", "glider", "--out", str(out)]) == 2
    message = (
        "error: simulator.plant: given 'glider', expected one of "
        "betaflight, internal, mujoco, rotorpy, rotors\n"
    )
    assert capsys.readouterr().err == message
    assert not out.exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_refuses_a_read_only_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tmp_path.chmod(0o500)

    assert main(["simulate", "--out", str(tmp_path / "run")]) == 2

    assert "cannot be written" in capsys.readouterr().err


BAD_FILES = {
    "unknown everywhere": ("/**: {ros__parameters: {colour: red}}\n", "colour"),
    "unknown in a group": ("mpc: {ros__parameters: {solver: {speed: 1}}}\n", "mpc.solver.speed"),
}


@pytest.mark.parametrize("kind", BAD_FILES)
def test_refuses_a_bad_parameter_file(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, message = BAD_FILES[kind]
    file = tmp_path / "parameters.yaml"
    file.write_text(text)

    assert main(["simulate", "--config", str(file), "--out", str(tmp_path / "run")]) == 2

    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_wildcard_sets_every_node_with_the_parameter(tmp_path: Path) -> None:
    from quad_mpc_ros.commands.run_configuration import SCHEMA
    from quad_mpc_ros.configuration import files

    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**: {ros__parameters: {mass: 0.5, use_sim_time: true}}\n"
        "/uav1/mpc: {ros__parameters: {mass: 1, advanced: {solver: {max_iterations: 50}}}}\n"
    )

    loaded = files.load([str(file)], ["simulator.drag=0.3"], schema=SCHEMA)

    assert loaded["mpc"].flattened()["mass"] == 1.0
    assert loaded["mpc"].flattened()["advanced.solver.max_iterations"] == 50
    assert loaded["simulator"].flattened()["mass"] == 0.5
    assert loaded["simulator"].flattened()["drag"] == 0.3


@pytest.mark.parametrize("arguments", [["report"], ["bag", "repair"], ["simulate", "--config"]])
def test_a_path_that_is_too_long_is_refused(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, "x" * 300]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
