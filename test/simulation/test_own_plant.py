# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A plant and a control law of another package, passed to the loop or registered."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.own_package import ROOT, kept
from numpy.testing import assert_array_equal

from quad_mpc_ros.cli import main
from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant

TWO_SECONDS = SimulatorConfig(duration=2.0)
HOVER = ReferenceConfig(trajectory="hover", height=1.0)


def position_error(step: LoopStep) -> float:
    return float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]))


def test_the_plant_of_contributing_is_registered() -> None:
    path = "quad_mpc_ros/simulation/config.py"
    lines = (ROOT / path).read_text().splitlines()
    assert len(kept(path)) == 3
    assert set(kept(path)) <= set(lines)


def test_flies_a_given_plant(own_package: SimpleNamespace) -> None:
    bricks = own_package.bricks
    brick = bricks.Brick(
        bricks.BrickParameters(initial_position=(0.3, 0.0, 1.0), initial_throttle=0.3)
    )
    steps = list(fly(plant=brick, simulator=TWO_SECONDS, reference=HOVER))
    assert_array_equal(steps[0].truth.p_WB, [0.3, 0.0, 1.0])
    assert position_error(steps[-1]) < 0.02


def test_flies_a_given_control_law() -> None:
    """One that holds the height alone, every other odometry."""
    law_calls = 0

    def law(odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        nonlocal law_calls
        law_calls += 1
        if law_calls % 2 == 0:
            return None
        error = window.p_WB[0, 2] - odometry.p_WB[2]
        return CommandSample(
            stamp_ns=odometry.stamp_ns,
            throttle=0.2923 + 0.5 * error - 0.3 * odometry.v_WB_B[2],
            w_WB_B=np.zeros(3),
        )

    simulator = SimulatorConfig(
        duration=4.0, initial_position=(0.0, 0.0, 0.8), initial_throttle=0.3
    )
    steps = list(fly(controller=law, simulator=simulator, reference=HOVER))
    assert law_calls == len(steps) == 200
    assert position_error(steps[-1]) < 0.01
    assert [step.command is None for step in steps] == 100 * [False, True]
    assert all(step.tick is None for step in steps)


def test_without_any_configuration_the_square_is_flown_for_ten_seconds() -> None:
    steps = list(fly())
    assert len(steps) == 500
    assert_array_equal(steps[0].window.p_WB[0], [0.0, 0.0, 2.0])
    assert np.sqrt(np.mean([position_error(step) ** 2 for step in steps])) < 1.02


def test_makes_a_registered_plant_with_its_parameters(
    own_package: SimpleNamespace,
) -> None:
    config = SimulatorConfig.build({"plant": "brick", "brick_drag": 0.2})
    assert isinstance(make_plant(config), own_package.bricks.Brick)
    assert config.flattened()["brick_drag"] == 0.2
    with pytest.raises(
        ConfigurationError, match="'stone', expected one of betaflight, internal, mujoco, rot"
    ):
        SimulatorConfig.build({"plant": "stone"})


@pytest.mark.usefixtures("own_package")
def test_the_command_line_loads_the_preset_of_a_plant(tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = ["--reference", "hover", "--set", "simulator.brick_drag=0.05", "--duration", "1"]
    assert main(["simulate", "--plant", "brick", *options, "--out", str(out)]) == 0
    config = json.loads((out / "summary.json").read_text())["config"]
    assert config["simulator"]["brick_drag"] == 0.05
    assert config["mpc"]["drag"] == 0.25
