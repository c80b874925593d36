"""``quad_mpc bench`` as a user runs it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from fixtures.scripts import ROOT

from quad_mpc_ros.cli import main

ACADOS, CVXPY = (str(ROOT / "bench" / "peers" / f"{name}.py") for name in ("acados", "cvxpy"))
ALL = ["--peers", "controller", ACADOS, "paper", CVXPY]
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
    arguments = [*ALL, "--duration", "0.2", "--repeats", "2", "--steps", "5"]
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
    assert result["command"] == f"quad_mpc bench {' '.join(arguments)}"
    assert "this controller" in printed.out


def test_flies_the_controller_alone_unless_peers_are_given(tmp_path: Path) -> None:
    arguments = ["--duration", "0.1", "--repeats", "1", "--steps", "--out", str(tmp_path)]
    assert main(["bench", *arguments]) == 0

    result = json.loads((tmp_path / "performance.json").read_text())
    assert list(result["peers"]) == ["controller", "paper"]
    assert result["command"] == "quad_mpc bench --duration 0.1 --repeats 1 --steps"


PEER = """
from dataclasses import dataclass
from pathlib import Path

from quad_mpc_ros import CommandSample
from quad_mpc_ros.experiments.bench.peers import Effort, PeerKind


@dataclass
class Hover:
    throttle: float = 0.3

    def step(self, odometry, window):
        return CommandSample(
            stamp_ns=odometry.stamp_ns, throttle=self.throttle, w_WB_B=0.0 * odometry.p_WB
        )

    def effort(self):
        return Effort(solved=True, iterations=0, solve_time=0.0)


PEER = PeerKind(title="hover", solver="none", description="no control", make=lambda *_: Hover)
"""


def test_a_peer_of_the_users_file_flies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "hover.py", tmp_path / "out"
    file.write_text(PEER)
    arguments = ["--peers", str(file), "--duration", "0.1", "--repeats", "1", "--steps"]
    assert main(["bench", *arguments, "--out", str(out)]) == 0

    result = json.loads((out / "performance.json").read_text())
    assert [each["peer"] for each in result["entries"]] == ["hover"]
    assert "hover" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "words"),
    [("import nothing_of_this_name", "nothing_of_this_name"), ("PEER = 3", "expected a PeerKind")],
)
def test_a_file_that_defines_no_peer_is_refused(
    content: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "broken.py"
    file.write_text(content)

    assert main(["bench", "--peers", str(file), "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err


def test_every_peer_that_is_installed_flies(tmp_path: Path) -> None:
    pytest.importorskip("cvxpy", reason="the extra 'bench' is not installed")
    pytest.importorskip("acados", reason="the extra 'bench' is not installed")
    arguments = [*ALL, "--duration", "0.1", "--repeats", "1", "--steps"]
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
    "peer": (["--peers", "acados"], ["--peers", "'acados'", "bench/peers/acados.py"]),
    "peer twice": (["--peers", CVXPY, "cvxpy.py"], ["--peers", "cvxpy is given twice"]),
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
    arguments, message = MISTAKES[mistake]
    out = tmp_path / "run"

    assert main(["bench", *arguments, "--out", str(out)]) == 2

    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    for word in message:
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
