# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc preflight`` with what it is given wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.cli import main

pytest.importorskip("rclpy")

MISTAKES = {
    "no such bridge": (["--bridge", "kite"], "--bridge: given 'kite', expected one of"),
    "no namespace": (["--namespace", "two words"], "--namespace: given 'two words'"),
    "no time": (["--timeout", "0"], "--timeout: given 0.0, expected 1 or more"),
    "no end": (["--timeout", "inf"], "--timeout: given inf"),
    "no file": (["--config", "nowhere.yaml"], "given 'nowhere.yaml'"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_exit_code_2(
    mistake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, message = MISTAKES[mistake]
    assert main(["preflight", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    assert message in printed.err


def test_an_unknown_parameter_of_a_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text("px4_bridge: {ros__parameters: {speed: 1}}\n")
    assert main(["preflight", "--config", str(file)]) == 2
    assert "px4_bridge.speed" in capsys.readouterr().err


def test_reports_missing_nodes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["preflight", "--timeout", "1"]) == 1
    printed = capsys.readouterr()
    lines = [line.split(maxsplit=2) for line in printed.out.splitlines()]
    assert ["error", "nodes"] in [line[:2] for line in lines]
    assert "no mpc node in this namespace" in printed.out
    assert "to fix before the flight" in printed.err
