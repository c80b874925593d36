"""What can be asked of ``quad_mpc soak``, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.cli import main
from quad_mpc_ros.experiments.faults.cases import FAULTS

MISTAKES = {
    "unknown fault": (["--faults", "odometry_stop"], ["--faults", "odometry_stop", "solver_lies"]),
    "on the ground": (["--faults", "ground_solver_fails"], ["--faults", "ground_solver_fails"]),
    "dropout": (["--dropout", "1.5"], ["--dropout", "1.5", ">= 0 and < 1"]),
    "duration": (["--duration", "0"], ["--duration", "0", "> 0"]),
    "both": (["--faults", "all", "--duration", "9"], ["--duration", "without --faults"]),
    "requests": (["--set", "reference.mode=on_request"], ["reference.mode", "at_once"]),
    "parameter": (["--set", "mpc.horizn_steps=3"], ["mpc.horizn_steps", "horizon_steps"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_exit_code_2(
    mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, message = MISTAKES[mistake]
    assert main(["soak", *arguments, "--out", str(tmp_path / "run")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    for word in message:
        assert word in printed.err


@pytest.mark.parametrize("name", ["soak.json", "soak.png", "log"])
def test_existing_results_are_left_alone(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    precious = tmp_path / name
    precious.write_text("do not touch")
    assert main(["soak", "--out", str(tmp_path)]) == 2
    assert str(precious) in capsys.readouterr().err
    assert precious.read_text() == "do not touch"


def test_faults_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["soak", "--list"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row.split("`")[1] for row in rows[2:]] == list(FAULTS)
    (row,) = (row for row in rows if "`odometry_stops`" in row)
    assert "mpc, blind by 0.42 s, silent by 1.44 s" in row
