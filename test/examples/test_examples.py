# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run every example as a program and check its outcome."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.cli import main

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"

Names = dict[str, Any]


def first_step(names: Names) -> None:
    assert names["tick"].decision.source.name == "MPC"
    assert names["summary"]["position_rmse_m"] == pytest.approx(1.008, abs=0.01)


def closed_loop(names: Names) -> None:
    rmse = names["rmse"]
    assert rmse["paper"] < rmse["agile"] < rmse["paper_rigid_body"] < rmse["default"] < 1.05


def own_plant(names: Names) -> None:
    assert names["summary"]["position_rmse_m"] < 1.0
    assert names["thrust_scale"] == pytest.approx(0.9 / 1.1, abs=0.03)


def own_controller(names: Names) -> None:
    assert names["rmse"]["MPC"] < 0.01 < names["rmse"]["PID"] < 0.5


def own_reference(names: Names) -> None:
    assert names["rmse"] < 0.001
    assert names["speed"].max() == pytest.approx(np.hypot(2.0, 1.0) * np.pi / 3.0, rel=1e-2)


def own_weights(names: Names) -> None:
    rmse, fastest = names["rmse"], names["fastest"]
    assert rmse["default"] < rmse["calm"] < rmse["slow"]
    assert fastest["calm"] < fastest["default"] and fastest["bounded"] <= 3.0 + 1e-9
    assert "above the hover throttle" in names["refusal"]


def wind(names: Names) -> None:
    assert names["error"][True] < 0.001 < names["error"][False]
    assert names["disturbance_x"] == pytest.approx(0.2 * 5.0, abs=0.05)


def read_bag(names: Names) -> None:
    assert len(names["flight"].time) == 350
    assert names["summary"]["fallbacks"] == 0


def identify_vehicle(names: Names) -> None:
    found = names["found"]
    roll, pitch, _ = found.rate_time_constant
    assert (roll.value, pitch.value) == pytest.approx((0.04, 0.04), abs=0.002)
    assert found.thrust_time_constant.value == pytest.approx(0.03, abs=0.002)
    assert found.input_delay.value == pytest.approx(0.02, abs=0.002)
    assert names["mpc"].input_delay == found.input_delay.value


def resolve_flight(names: Names) -> None:
    difference = names["difference"]
    assert difference.pop("as flown") == 0.0
    assert min(difference.values()) > 1e-3


def check_reference(names: Names) -> None:
    assert names["highest"][2.0] < 1.0 < names["highest"][3.0]
    assert "within the vehicle's limits" in names["refusal"]
    assert names["seconds"] > 2.0 * np.pi / 3.0


def custom_bridge(names: Names) -> None:
    assert len(names["sent"]) == 3 and names["refused"]
    assert all(message.thrust_newton > 3.0 for message in names["sent"])


def ros_node(names: Names) -> None:
    assert len(names["vehicle"].commands) >= 20
    assert names["last"].twist.linear.z > 0.5


OUTCOMES: dict[str, Callable[[Names], None]] = {
    outcome.__name__: outcome
    for outcome in (
        first_step,
        closed_loop,
        own_controller,
        own_plant,
        own_reference,
        own_weights,
        wind,
        read_bag,
        identify_vehicle,
        resolve_flight,
        check_reference,
        custom_bridge,
        ros_node,
    )
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a flight of a vehicle with lags and a delay, for the examples that read one."""
    out = str(tmp_path_factory.mktemp("flight") / "run")
    plant = ("rate_time_constant=0.04", "thrust_time_constant=0.03", "command_delay=0.02")
    sets = [word for each in plant for word in ("--set", f"simulator.{each}")]
    sets += [
        "--set",
        "reference.angular_frequency=1.5",
    ]  # a slower flight does not excite the delay
    assert (
        main(["simulate", "--reference", "lemniscate", *sets, "--duration=7", "--out", out]) == 0
    )
    return out


@pytest.mark.parametrize("name", OUTCOMES)
def test_example_prints_the_expected_outcome(
    name: str,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = EXAMPLES / f"{name}.py"
    if name == "ros_node":
        pytest.importorskip("rclpy")
    given = [request.getfixturevalue("bag")] if "[BAG]" in path.read_text() else []
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", [str(path), *given])
    names = runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out
    OUTCOMES[name](names)


def test_every_example_has_an_outcome_and_is_listed() -> None:
    files = {path.stem for path in EXAMPLES.glob("*.py")}
    assert files == OUTCOMES.keys()
    listed = re.findall(r"\]\((\w+)\.py\)", (EXAMPLES / "README.md").read_text())
    assert sorted(listed) == sorted(files)


def test_examples_are_short() -> None:
    for path in EXAMPLES.glob("*.py"):
        assert len(path.read_text().splitlines()) <= 77, path  # two of them on the licence


def test_the_readme_shows_the_first_step() -> None:
    readme = (ROOT / "README.md").read_text()
    (shown,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    program = (EXAMPLES / "first_step.py").read_text()
    assert program.partition('"""\n\n')[2] == shown
