# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A trajectory of another package, passed to the loop or registered by entry point."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros import simulate, summarise
from quad_mpc_ros.cli import main
from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory


def test_closed_loop_flies_a_given_path(own_package: SimpleNamespace) -> None:
    swings = own_package.swings
    swing = swings.Swing(swings.SwingParameters(swing_width=1.5))
    flight = simulate(trajectory=swing, duration=2.0, on_reference=True)
    assert len(flight.time) == len(flight.commands.stamp_ns) == 100
    assert flight.time[-1] == pytest.approx(1.98)
    assert_array_equal(flight.p_WB[0], [0.0, 0.0, 2.0])
    assert summarise(flight)["position_rmse_m"] < 0.01
    assert np.isfinite(flight.commands.throttle).all()
    assert np.isfinite(flight.commands.w_WB_B).all()


@pytest.mark.usefixtures("own_package")
def test_a_registered_trajectory_has_its_own_parameters() -> None:
    config = ReferenceConfig.build({"trajectory": "swing", "swing_width": 2, "height": 1.0})
    assert isinstance(config, ReferenceConfig)
    assert config.flattened()["swing_width"] == 2.0
    quarter = configured_trajectory(config).at([round(0.5e9 * np.pi)])
    assert_allclose(quarter.p_WB, [[2.0, 0.0, 1.0]], atol=1e-9)
    # After those of every other trajectory, in their order, and before the advanced ones.
    names = [spec.name for spec in config.specs()]
    known = [spec.name for spec in ReferenceConfig.specs()]
    advanced = [name for name in known if name.startswith("advanced.")]
    everyday = known[: len(known) - len(advanced)]
    assert names == [*everyday, "swing_width", "swing_rate", *advanced]
    assert config.updated({"swing_width": 3.0}).flattened()["swing_width"] == 3.0
    assert ReferenceConfig.build(config.flattened()) == config
    with pytest.raises(ConfigurationError, match=r"reference.swing_width: given -1.0, .* > 0"):
        ReferenceConfig.build({"trajectory": "swing", "swing_width": -1.0})


@pytest.mark.usefixtures("own_package")
def test_own_parameters_are_unknown_to_others() -> None:
    with pytest.raises(ConfigurationError, match=r"swing_width: .* a known parameter"):
        ReferenceConfig.build({"trajectory": "circle", "swing_width": 2.0})


@pytest.mark.usefixtures("own_package")
def test_command_line_checks_and_flies_the_trajectory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--reference", "swing", "--set", "reference.swing_width=0.5"]
    assert main(["check-reference", *arguments, "--out", str(tmp_path / "check")]) == 0
    assert "highest throttle" in capsys.readouterr().out
    out = tmp_path / "run"
    assert main(["simulate", *arguments, "--duration", "1", "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["position_rmse_m"] < 0.01
    assert summary["config"]["reference"]["swing_width"] == 0.5


@pytest.mark.usefixtures("own_package")
def test_refuses_broken_entry_points() -> None:
    with pytest.raises(ConfigurationError, match="given 'spiral', expected one of square, hover"):
        ReferenceConfig.build({"trajectory": "spiral"})
    with pytest.raises(UserError, match=r"ghost = not_there:GHOST cannot be loaded"):
        ReferenceConfig.build({"trajectory": "ghost"})
    with pytest.raises(UserError, match=r"quad_mpc_ros.trajectories: bare is <class"):
        ReferenceConfig.build({"trajectory": "bare"})
    with pytest.raises(ConfigurationError, match=r"circle_radius: .* a name that is not in thief"):
        ReferenceConfig.build({"trajectory": "thief"})


def test_needs_only_its_own_parameters(own_package: SimpleNamespace) -> None:
    swings = own_package.swings
    config = swings.SwingParameters(origin=(1.0, 2.0), height=3.0)
    trajectory = FlatTrajectory(swings.Swing(config), config)
    assert_array_equal(trajectory.at([0]).p_WB, [[1.0, 2.0, 3.0]])
