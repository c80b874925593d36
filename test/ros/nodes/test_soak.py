"""``quad_mpc soak`` over DDS: the short version of what people run for half an hour."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from quad_mpc_ros.cli import main
from quad_mpc_ros.experiments.faults.cases import FAULTS

# One of each kind; the others fly in one process.
CAMPAIGN = (
    "odometry_stops",
    "odometry_nan",
    "two_odometries",
    "reference_empty",
    "solver_fails",
    "solver_lies",
    "mpc_pauses",
    "simulator_restarts",
    "parameters_hammered",
)


def soak(out: Path, *arguments: str) -> dict[str, Any]:
    code = main(["soak", *arguments, "--out", str(out)])
    result: dict[str, Any] = json.loads((out / "soak.json").read_text())
    assert code == (0 if result["holds"] else 1)
    assert result["unsound_commands"] == 0
    assert (out / "soak.png").stat().st_size > 10_000
    return result


@pytest.mark.slow
def test_faults_reach_the_expected_rungs(tmp_path: Path) -> None:
    """A machine that stalls may spoil a course; what fails twice is no stall."""
    result = soak(tmp_path / "first", "--faults", ",".join(CAMPAIGN))
    assert result["complaints"] == []
    assert list(result["faults"]) == list(CAMPAIGN)
    failed = [name for name, fault in result["faults"].items() if not fault["holds"]]
    if failed:
        again = soak(tmp_path / "again", "--faults", ",".join(failed))
        told = {name: fault["complaints"] for name, fault in again["faults"].items()}
        assert again["holds"], told


@pytest.mark.slow
def test_every_fault_reaches_the_expected_rungs(tmp_path: Path) -> None:
    result = soak(tmp_path / "all", "--faults", "all")
    failed = {n: f["complaints"] for n, f in result["faults"].items() if not f["holds"]}
    assert failed == {}
    assert len(result["faults"]) == sum(not fault.grounded for fault in FAULTS.values())


def test_endurance(tmp_path: Path) -> None:
    """How late ticks are is the machine's matter; that they come, and are sound, is not."""
    result = soak(tmp_path / "run", "--duration", "8", "--dropout", "0.05")
    assert result["ticks"] >= 200
    assert result["sources"]["mpc"] >= 0.9 * result["ticks"]
    assert result["parameter_changes"] >= 6
    assert result["parameters_refused"] == []
    assert result["crashed"] is False
    assert abs(result["memory_mb"]["growth"]) < 5.0
