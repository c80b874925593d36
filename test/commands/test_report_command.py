# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc report`` on valid and invalid bags."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from quad_mpc_ros.cli import main


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        # The bags are what is wanted; the figures of each run take longer than its flight.
        patch.setattr("quad_mpc_ros.commands.simulate.finish", lambda out, wall_seconds: 0)
        for name, preset in (("manifold", "default"), ("paper", "paper")):
            out = str(folder / name)
            code = main(["simulate", "--config", preset, "--duration", "2.5", "--out", out])
            assert code == 0
    return folder / "manifold", folder / "paper"


def test_page_of_two_runs(runs: tuple[Path, Path], tmp_path: Path) -> None:
    first, second = runs
    arguments = ["report", str(first), str(second / "bag"), "--out", str(tmp_path / "two.html")]
    assert main(arguments) == 0
    text = (tmp_path / "two.html").read_text(encoding="utf-8")
    assert "<h1>manifold, paper</h1>" in text
    assert not list(tmp_path.rglob("*.part"))


def test_overwrites_only_with_the_overwrite_option(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "page.html"
    out.write_text("do not touch")
    assert main(["report", str(runs[0]), "--out", str(out)]) == 2
    assert "exists and is not overwritten" in capsys.readouterr().err
    assert out.read_text() == "do not touch"
    assert main(["report", str(runs[0]), "--out", str(out), "--overwrite"]) == 0
    assert out.read_text().startswith("<!DOCTYPE html>")


def test_runs_of_the_same_name_are_numbered(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / "manifold"
    shutil.copytree(runs[0] / "bag", again / "bag")
    out = tmp_path / "page.html"
    assert main(["report", str(runs[0]), str(again), "--out", str(out)]) == 0
    assert "<h1>manifold, manifold_2</h1>" in out.read_text()
