# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Campaigns that fly: the same flights as simulated ones, by whatever workers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from fixtures.campaigns import CONTENT, children_of, flown_into, wait_until
from fixtures.engines import InThisProcess

from quad_mpc_ros.cli import main
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns import flight as flight_module
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_from
from quad_mpc_ros.extras.campaigns.flight import column_names, fly_one
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers
from quad_mpc_ros.recordings.evaluation.simulated import load_config, simulate
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.simulation import closed_loop


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> Path:
    """Return the folder of the campaign, flown in this process."""
    return flown_into(tmp_path_factory.mktemp("campaign") / "flown", InThisProcess())


def test_parameter_file_reproduces_a_flight(reference: Path, tmp_path: Path) -> None:
    campaign = campaign_from(CONTENT)
    plan = campaign.plan(3)
    mpc, simulator, of_reference = plan.config
    commands = [
        (step.command.throttle, *step.command.w_WB_B)
        for step in closed_loop.fly(mpc=mpc, simulator=simulator, reference=of_reference)
    ]
    file = reference / "flights" / "0003.yaml"
    assert main(["simulate", "--config", str(file), "--out", str(tmp_path / "run")]) in (0, 1)
    recorded = Recording(tmp_path / "run" / "bag").flight().commands
    assert np.array_equal(np.column_stack((recorded.throttle, recorded.w_WB_B)), commands)

    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    row = fly_one(campaign, 3).row
    assert row["position_rmse_m"] == summary["position_rmse_m"]
    assert row["iterations.max"] == summary["iterations"]["max"]


def test_table_has_every_scalar_of_the_summary_except_wall_times() -> None:
    campaign = campaign_from(CONTENT)
    summary = simulate(*load_config(), duration=0.1)
    from quad_mpc_ros.recordings.evaluation.metrics import summarise

    figures = summarise(summary)
    scalars = {name for name, value in figures.items() if not isinstance(value, dict | list)}
    # Without a course and obstacles there is no list of gates, and no collision with its parts.
    structured = {"gates", "collision"}
    assert scalars - set(column_names(campaign)) == {
        "realtime_factor",
        "stage_errors",
        *structured,
    }
    assert set(fly_one(campaign, 0).row) <= set(column_names(campaign))


def test_a_flight_that_raises_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def raising(**arguments):
        raise ZeroDivisionError("of\nnothing")

    monkeypatch.setattr(flight_module, "fly", raising)
    row = fly_one(campaign_from(CONTENT), 1).row
    assert row["error"] == "ZeroDivisionError: of nothing"
    assert row["simulator.seed"] == campaign_from(CONTENT).drawn(1)["simulator.seed"]
    assert not row["crashed"]


def test_a_flight_with_incompatible_parameters_is_a_row() -> None:
    """The throttle cannot carry nine times the mass."""
    content = {**CONTENT, "vary": {"simulator.mass_scale": {"choice": [1.0, 9.0]}}}
    campaign = campaign_from({**content, "seed": 4})
    rows = (fly_one(campaign, number).row for number in range(1, 20))
    heavy = next(row for row in rows if row["simulator.mass_scale"] == 9.0)
    assert "mass_scale" in heavy["error"]


def test_workers_fly_the_same_flights_as_one_process(reference: Path, tmp_path: Path) -> None:
    flown = flown_into(tmp_path / "flown", LocalWorkers(2))
    assert (flown / "flights.csv").read_bytes() == (reference / "flights.csv").read_bytes()


def test_death_of_a_worker_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The worker imports this: its flight with seed 2 kills it.
    plugin = tmp_path / "sitecustomize.py"
    plugin.write_text(
        "import os, signal\n"
        "from quad_mpc_ros.extras.campaigns import flight\n"
        "def killing(**arguments):\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
        "flight.fly = killing\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(UserError, match="a worker process died"), LocalWorkers(1) as engine:
        list(engine.fly(campaign_from(CONTENT), [range(4)]))


@pytest.mark.parametrize("after", [0.0, 1.0])  # s: workers begin, or fly
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_ctrl_c_or_a_kill(
    tmp_path: Path, after: float, sent: signal.Signals
) -> None:
    file, out = tmp_path / "file.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump({**CONTENT, "flights": 500, "duration": 3000.0}))
    command = [sys.executable, "-P", "-m", "quad_mpc_ros.cli", "campaign", str(file)]
    process = subprocess.Popen(
        [*command, "--out", str(out), "--workers", "2"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    # Not while Python still imports, where others may swallow it.
    wait_until(lambda: len(children_of(process.pid)) == 2)
    time.sleep(after)
    if sent == signal.SIGINT:
        os.killpg(process.pid, sent)  # as a terminal does
    else:
        process.kill()
    _, message = process.communicate(timeout=30)  # which waits for the workers as well
    assert process.returncode == (130 if sent == signal.SIGINT else -signal.SIGKILL)
    # After a kill, a worker that waits for its task finds a closed pipe: Python prints where.
    assert sent == signal.SIGKILL or "Traceback" not in message
    assert (out / "flights.csv").exists() == (sent == signal.SIGINT)  # finished flights


MISTAKES = {
    "no such file": (["hoover"], "no shipped campaign"),
    "workers": (["{file}", "--workers", "0"], "--workers: given 0"),
    "flights": (["{file}", "--flights", "0"], "flights: given 0"),
    "set": (["{file}", "--set", "mpc.mas=1"], "mpc.mas"),
    "varied and set": (["{file}", "--set", "simulator.seed=1"], "simulator.seed: also set"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_on_the_command_line_are_one_line(
    mistake: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments, message = MISTAKES[mistake]
    file, out = tmp_path / "file.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump(CONTENT))
    given = [argument.format(file=file) for argument in arguments]
    assert main(["campaign", *given, "--out", str(out)]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert len(printed.strip().splitlines()) == 1
    assert not out.exists()
