# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc --help``: its text and its few imports."""

from __future__ import annotations

import subprocess
import sys

import pytest

from quad_mpc_ros.cli import COMMANDS, main

SLOW = {"numpy", "scipy", "numba", "rclpy", "matplotlib", "rosbags", "osqp", "yaml"}


def test_help_imports_no_slow_modules() -> None:
    program = f"""
import sys
from quad_mpc_ros.cli import main
try:
    main(["--help"])
except SystemExit as end:
    assert end.code == 0
slow = {{name.split(".")[0] for name in sys.modules}} & {SLOW!r}
assert not slow, slow
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    for name in COMMANDS:
        assert name in done.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: quad_mpc {name} ")


@pytest.mark.parametrize("name", sorted(COMMANDS.keys() - {"bag", "campaign", "tune"}))
def test_an_unknown_argument_points_to_the_help_of_the_command(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = ["some"] if name in ("replay", "resolve", "identify", "report", "plan") else []
    taken += ["--out", "file"] if name == "identify" else []
    with pytest.raises(SystemExit) as end:
        main([name, *taken, "--nonsense"])
    assert end.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "error: given --nonsense, expected no such argument",
        f"see quad_mpc {name} --help",
    ]


def test_a_closed_pipe_ends_without_a_message() -> None:
    """A pipe such as ``quad_mpc params | head`` closes in the middle or at the last flush."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "quad_mpc_ros.cli", "params"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    message = process.stderr.read()
    process.stderr.close()
    assert (process.wait(timeout=60), message) == (141, b"")
