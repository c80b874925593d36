# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``--controller`` on the command line, saved runs, and their figures as PDF."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros import FunctionPath, MpcConfig, Recording, SimulatorConfig, simulate_run
from quad_mpc_ros.cli import main
from quad_mpc_ros.recordings.evaluation.metrics import summarise

BROKEN = """\
class Broken:
    def __init__(self, config):
        self.left = 20

    def reset(self):
        pass

    def step(self, odometry, reference):
        self.left -= 1
        if self.left < 0:
            raise RuntimeError("no ideas left")
        from quad_mpc_ros import CommandSample
        return CommandSample(stamp_ns=odometry.stamp_ns, throttle=0.3, w_WB_B=[0.0, 0.0, 0.0])
"""
HOVER = ("simulate", "--reference", "hover", "--duration", "2")


def test_a_named_controller_flies_and_is_reported_next_to_the_mpc(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("mpc", "px4"):
        out = str(tmp_path / name)
        assert main([*HOVER, "--controller", name, "--out", out]) == 0
    assert "The controller px4 sent all 100 commands." in capsys.readouterr().out
    page = tmp_path / "page.html"
    runs = [str(tmp_path / "mpc"), str(tmp_path / "px4")]
    assert main(["report", *runs, "--out", str(page), "--format", "pdf"]) == 0
    figures = {path.name for path in (tmp_path / "page_figures").iterdir()}
    assert {"path_mpc.pdf", "path_px4.pdf", "position.pdf", "inputs.pdf"} <= figures
    assert (tmp_path / "page_figures" / "position.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(SystemExit) as refused:
        main(["report", *runs, "--out", str(tmp_path / "b" / "page.html"), "--format", "gif"])
    assert refused.value.code == 2


def test_a_controller_of_the_working_directory_that_fails_is_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_module.py").write_text(BROKEN)
    monkeypatch.chdir(tmp_path)
    assert main([*HOVER, "--controller", "broken_module:Broken", "--out", "run"]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if "no ideas left" in line]
    assert len(lines) == 1 and lines[0].startswith("verdict")
    assert (tmp_path / "run" / "summary.json").is_file()


@pytest.mark.parametrize(
    "command",
    [
        HOVER,
        ("campaign", "hover", "--flights", "1"),
        ("rehearse",),
    ],
)
def test_an_unknown_controller_is_exit_code_2_with_the_names(
    command: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--controller", "nosuch", "--out", str(tmp_path / "run")]) == 2
    assert "expected one of mpc, geometric, px4, lqr" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_flight_from_python_is_saved_as_a_run(tmp_path: Path) -> None:
    path = FunctionPath(lambda t: (t**4 * (1 - t / 8) ** 4, 0.0, 2.0), duration=8.0)
    config = MpcConfig(controller="geometric")
    simulator = SimulatorConfig(position_noise=0.01)
    flown = simulate_run(tmp_path / "run", config, simulator, trajectory=path, duration=2.0)
    recorded = Recording(tmp_path / "run").flight()
    assert summarise(recorded)["position_rmse_m"] == summarise(flown)["position_rmse_m"]
    assert recorded.mpc.controller == "geometric"
    assert (tmp_path / "run" / "figures" / "position.png").is_file()
    assert (tmp_path / "run" / "summary.json").is_file()
