"""``quad_mpc bench`` as a user runs it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from quad_mpc_ros.cli import main

RESULTS = ["performance.json", "performance.md", "performance.png"]


@pytest.fixture
def no_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let cvxpy and acados be not installed."""
    for name in ("cvxpy", "acados"):
        monkeypatch.setitem(sys.modules, name, None)  # type: ignore[arg-type]


@pytest.mark.usefixtures("no_peers")
def test_what_is_not_installed_is_skipped_with_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--duration", "0.2", "--repeats", "2", "--steps", "5"]
    assert main(["bench", *arguments, "--out", str(tmp_path)]) == 0

    assert sorted(path.name for path in tmp_path.iterdir()) == RESULTS
    printed = capsys.readouterr()
    notes = [line for line in printed.err.splitlines() if "skipped" in line]
    assert len(notes) == 2
    assert all("pip install 'quad_mpc_ros[bench]'" in note for note in notes)
    result = json.loads((tmp_path / "performance.json").read_text())
    assert set(result["skipped"]) == {"cvxpy", "acados"}
    flown = [(each["peer"], each["horizon_steps"]) for each in result["entries"]]
    assert flown == [("controller", 10), ("paper", 10), ("controller", 5)]
    assert all(each["flights"] == 2 and each["steps"] == 20 for each in result["entries"])
    assert result["command"] == "quad_mpc bench --duration 0.2 --repeats 2 --steps 5"
    assert "this controller" in printed.out


def test_every_peer_that_is_installed_flies(tmp_path: Path) -> None:
    pytest.importorskip("cvxpy", reason="the extra 'bench' is not installed")
    pytest.importorskip("acados", reason="the extra 'bench' is not installed")
    arguments = ["--duration", "0.1", "--repeats", "1", "--steps"]
    assert main(["bench", *arguments, "--out", str(tmp_path)]) == 0

    result = json.loads((tmp_path / "performance.json").read_text())
    assert result["skipped"] == {}
    assert [each["peer"] for each in result["entries"]] == [
        "controller",
        "acados",
        "paper",
        "cvxpy",
    ]
    assert all(each["failed_steps"] == 0 for each in result["entries"])


MISTAKES = {
    "peer": (["--peers", "acadoz"], ["--peers", "acadoz", "acados", "cvxpy"]),
    "duration": (["--duration", "-3"], ["--duration", "-3", "> 0"]),
    "endless": (["--duration", "inf"], ["--duration", "inf", "> 0"]),
    "repeats": (["--repeats", "0"], ["--repeats", "0", ">= 1"]),
    "no horizon": (["--steps", "5", "0"], ["--steps", "0", "200"]),
    "too long a horizon": (["--steps", "201"], ["--steps", "201", "200"]),
    "parameter": (["--set", "mpc.horizn_steps=3"], ["mpc.horizn_steps", "horizon_steps"]),
    "formulation": (["--set", "mpc.formulation=paper"], ["mpc.formulation", "manifold"]),
    "preset": (["--config", "papper"], ["papper", "default"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_exit_code_2(
    mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, told = MISTAKES[mistake]
    out = tmp_path / "run"

    assert main(["bench", *arguments, "--out", str(out)]) == 2

    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    for word in told:
        assert word in printed.err
    assert not out.exists()


@pytest.mark.parametrize("name", RESULTS)
def test_existing_measurements_are_left_alone(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text("do not touch")

    assert main(["bench", "--duration", "0.1", "--out", str(tmp_path)]) == 2

    assert str(tmp_path / name) in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "do not touch"
