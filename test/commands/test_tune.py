# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc tune`` from the command line: a small study that is really flown, and mistakes."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

pytest.importorskip("optuna")

from fixtures.engines import InThisProcess

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands import campaign, tune

STUDY = """
seed: 1
trials: 2
search:
  mpc.horizon_steps: {integers: [8, 12]}
  mpc.R.1: {log_uniform: [0.001, 1.0]}
campaigns:
  hover: {flights: 2, reference: hover, duration: 1.0, start: reference}
objectives:
  - {campaign: hover, figure: crashed}
  - {campaign: hover, figure: position_rmse_m, of: p95}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(STUDY)
    return path


def test_study_is_flown_resumed_and_its_best_flies(
    file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tune, "engine_of", lambda options: InThisProcess())
    monkeypatch.setattr(campaign, "engine_of", lambda options: InThisProcess())
    out = tmp_path / "out"
    assert main(["tune", str(file), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "2 trials: 2 flown" in printed
    assert re.search(r"^ *start +0 ", printed, re.MULTILINE)
    for name in ("tune.yaml", "study.db", "trials.csv", "best.yaml"):
        assert (out / name).is_file(), name

    # The command that it names checks what was chosen.
    (command,) = (line for line in printed.splitlines() if "quad_mpc campaign" in line)
    assert main(command.split()[1:]) == 0
    assert "2 flights: 0 crashed" in capsys.readouterr().out

    assert main(["tune", "--resume", str(out), "--trials", "3"]) == 0
    assert "3 trials: 3 flown" in capsys.readouterr().out


MISTAKES = {
    "no file": ([], "FILE: expected"),
    "trials": (["FILE", "--trials", "0"], "--trials: given 0, expected a number >= 1"),
    "resume what": (["--resume", "HERE"], "expected the folder of a study"),
    "resume and out": (
        ["--resume", "HERE", "--out", "x"],
        "continues unchanged: omit FILE, --out",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_exit_code_2(
    mistake: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, message = MISTAKES[mistake]
    places = {"FILE": str(file), "HERE": str(tmp_path)}
    assert main(["tune", *(places.get(each, each) for each in arguments)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    assert message in printed.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.yaml"]


def test_without_optuna_names_the_install_command(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert main(["tune", str(file)]) == 2
    assert "pip install 'quad_mpc_ros[campaign]'" in capsys.readouterr().err
