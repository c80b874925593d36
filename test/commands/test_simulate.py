# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc simulate`` as a user runs it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from rosbags.highlevel import AnyReader

from quad_mpc_ros.cli import main

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulate") / "run"
    assert main(["simulate", "--config", "paper", "--out", str(out)]) == 0
    return out


def test_the_papers_square(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    assert summary["position_rmse_m"] == pytest.approx(0.788, abs=0.01)
    assert len(summary["waypoint_error_m"]) >= 4
    assert max(summary["waypoint_error_m"]) <= 0.03
    assert summary["iterations"]["p99"] <= 75
    assert summary["iterations"]["max"] <= 100
    assert summary["solver_failures"] == summary["fallbacks"] == 0
    assert summary["commands"] == 500


def test_bag_is_complete_and_opens_in_other_readers(run: Path) -> None:
    with AnyReader([run / "bag"]) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    for topic in ("/odom", "/reference", "/command", "/mpc/stats", "/mpc/predicted_path"):
        assert counts[topic] == 500
    assert counts["/reference/path"] == 1


def test_simulate_imports_no_ros(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "from quad_mpc_ros.cli import main\n"
        f"code = main(['simulate', '--duration', '0.2', '--out', {str(tmp_path / 'run')!r}])\n"
        "ros = [name for name in sys.modules if name.split('.')[0] in\n"
        "       ('rclpy', 'nav_msgs', 'geometry_msgs', 'trajectory_msgs', 'std_msgs')]\n"
        "sys.exit(repr(ros) if ros else code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("task", ["gates", "obstacles"])
def test_misses_nothing_in_the_default_duration(task: str, tmp_path: Path) -> None:
    course = yaml.safe_load((ROOT / "config" / "gates" / "split_s.yaml").read_text())
    (tmp_path / "gates.yaml").write_text(yaml.safe_dump({**course, "order": [3, 4, 5]}))
    arguments = {
        "gates": ["--gates", str(tmp_path / "gates.yaml")],  # a fifth of the course
        "obstacles": ["--obstacles", str(ROOT / "examples" / "pillars.yaml"), "--sensor", "rays"],
    }
    assert main(["simulate", *arguments[task], "--out", str(tmp_path / "run")]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["missed"] == []
    assert not summary["crashed"] and not summary["collided"]


def test_failsafe_flight_is_not_a_success(tmp_path: Path) -> None:
    arguments = ["--set", "mpc.advanced.solver.max_iterations=1", "--duration", "1"]
    assert main(["simulate", *arguments, "--out", str(tmp_path / "run")]) == 1


def test_a_crash_is_not_a_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its commands are all the MPC's: a late vehicle is lost without a fallback."""
    late = ["--config", "agile", "--set", "simulator.command_delay=0.15"]
    beside = ["--set", "simulator.initial_position=[0.7,0.0,1.0]"]
    warn = [
        "--set=mpc.advanced.oscillation.action=warn",
        "--set=mpc.consistency.action=warn",
    ]
    arguments = ["--reference", "hover", *late, *beside, *warn, "--duration", "2"]
    assert main(["simulate", *arguments, "--out", str(tmp_path / "run")]) == 1
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["crashed"] is True
    assert summary["fallbacks"] == 0
    assert "crashed at" in capsys.readouterr().out.lower()


def test_aggressive_turn_is_not_a_crash(tmp_path: Path) -> None:
    """By agile the vehicle swings beyond 90° for a tenth of a second at the square's corners."""
    arguments = ["--config", "agile", "--duration", "4", "--out", str(tmp_path / "run")]
    assert main(["simulate", *arguments]) == 0
