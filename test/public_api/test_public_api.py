# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The public API: names, imports, types and examples."""

from __future__ import annotations

import ast
import doctest
import importlib
import re
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import quad_mpc_ros
from quad_mpc_ros import Flight, ReferenceConfig, load_config, simulate, summarise
from quad_mpc_ros.cli import main
from quad_mpc_ros.recordings.recording import Recording

ROOT = Path(__file__).parents[2]
INIT = Path(quad_mpc_ros.__file__)

# What none who only controls should have to load.
# PyYAML is not among it: Numba itself imports that where it is installed.
HEAVY = {"matplotlib", "mcap", "mpl_toolkits", "pandas", "rclpy", "rosbags", "zstandard"}
CONTROL = "Controller, CommandSample, MpcConfig, OdometrySample, ReferenceWindow, Vehicle, so3"


def imported_by(statement: str) -> set[str]:
    """Return the top-level packages that a new Python has loaded after a statement."""
    program = f"{statement}\nimport sys\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    ended = subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True
    )
    return set(ended.stdout.split())


def test_both_lists_of_names_agree() -> None:
    """Type checkers read one list of names, the interpreter the other."""
    (guarded,) = [node for node in ast.parse(INIT.read_text()).body if isinstance(node, ast.If)]
    guarded_names = {
        alias.name: node.module
        for node in guarded.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    run = {
        name: f"quad_mpc_ros.{module}" for name, module in vars(quad_mpc_ros)["_MODULES"].items()
    }
    assert guarded_names == run
    assert sorted(guarded_names) == sorted(quad_mpc_ros.__all__)
    assert set(quad_mpc_ros.__all__) <= set(dir(quad_mpc_ros))


@pytest.mark.parametrize("name", quad_mpc_ros.__all__)
def test_every_name_exists_with_a_docstring(name: str) -> None:
    value = getattr(quad_mpc_ros, name)
    text = value.__doc__ or ""
    assert text
    if isinstance(value, types.FunctionType):
        assert "Args:" in text and "Returns:" in text


def test_every_name_can_be_imported_first_in_an_interpreter_of_its_own() -> None:
    program = """
import os
import numba, numpy, osqp, scipy.sparse
import quad_mpc_ros
for name in quad_mpc_ros.__all__:
    child = os.fork()  # which has imported nothing of the package
    if child == 0:
        exec(f"from quad_mpc_ros import {name}; assert {name} is quad_mpc_ros.{name}")
        os._exit(0)
    if os.waitpid(child, 0)[1] != 0:
        print(name)
"""
    ended = subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True
    )
    assert ended.stdout.split() == [], ended.stderr


def test_unknown_name_raises_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Kontroller'"):
        _ = quad_mpc_ros.Kontroller  # type: ignore[attr-defined]


def test_the_package_alone_imports_nothing_else() -> None:
    assert not imported_by("import quad_mpc_ros") & (HEAVY | {"numba", "numpy", "osqp", "scipy"})


def test_control_imports_no_reader_of_bags_and_no_figures() -> None:
    loaded = imported_by(f"from quad_mpc_ros import {CONTROL}")
    assert {"osqp", "numba"} <= loaded
    assert not loaded & HEAVY


def test_simulation_imports_no_reader_of_bags_and_no_figures() -> None:
    loaded = imported_by("from quad_mpc_ros import simulate, summarise; simulate(duration=0.02)")
    assert not loaded & HEAVY


def test_the_package_is_typed() -> None:
    assert (INIT.parent / "py.typed").exists()
    assert '"quad_mpc_ros": ["py.typed"]' in (ROOT / "setup.py").read_text()


def test_a_program_of_a_user_is_type_checked(tmp_path: Path) -> None:
    """A public API typed ``Any`` would let mistakes in calls pass."""
    pytest.importorskip("mypy")
    program = tmp_path / "program.py"
    program.write_text(
        "from quad_mpc_ros import Controller, MpcConfig, OdometrySample, ReferenceWindow\n"
        "controller = Controller(MpcConfig(horizon_steps=20))\n"
        "odometry = OdometrySample.at_rest([0.0, 0.0, 1.0])\n"
        "tick = controller.step(odometry, ReferenceWindow.hover([0.0, 0.0, 2.0]))\n"
        "if tick is not None and tick.command is not None:\n"
        "    throttle: float = tick.command.throttle\n"
        "    mistaken: str = tick.command.throttle\n"
        "Controller(odometry)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--config-file=", program],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    found = re.findall(r"program\.py:(\d+): error: .*\[([a-z-]+)\]", ended.stdout)
    assert found == [("7", "assignment"), ("8", "arg-type")], ended.stdout


@pytest.mark.parametrize(
    "module", ["", *sorted({f".{name}" for name in vars(quad_mpc_ros)["_MODULES"].values()})]
)
def test_docstring_examples_pass(module: str) -> None:
    found = importlib.import_module(f"quad_mpc_ros{module}")
    names = {name: getattr(quad_mpc_ros, name) for name in quad_mpc_ros.__all__}
    failed, _ = doctest.testmod(found, extraglobs=names, optionflags=doctest.ELLIPSIS)
    assert failed == 0


def test_simulate_flies_what_the_command_line_flies(tmp_path: Path) -> None:
    out = tmp_path / "run"
    given = ["--config", "paper_rigid_body", "--set", "simulator.position_noise=0.01"]
    assert main(["simulate", *given, "--duration", "1.5", "--out", str(out)]) == 0
    config = load_config("paper_rigid_body", assignments=["simulator.position_noise=0.01"])
    flight, recorded = simulate(*config, duration=1.5), Recording(out).flight()
    for name in ("stamp_ns", "p_WB", "q_WB_xyzw", "v_WB_B", "w_WB_B"):
        assert_array_equal(getattr(flight, name), getattr(recorded, name))
    assert_array_equal(flight.commands.throttle, recorded.commands.throttle)
    assert_array_equal(flight.commands.w_WB_B, recorded.commands.w_WB_B)
    assert flight.reference is not None and recorded.reference is not None
    assert_array_equal(flight.reference.throttle, recorded.reference.throttle)
    mine, replayed = summarise(flight), summarise(recorded)
    for name in ("position_rmse_m", "iterations", "commands", "fallbacks", "waypoint_error_m"):
        assert mine[name] == replayed[name], name


def test_simulate_sends_no_command_of_a_function_that_returns_none(
    caplog: pytest.LogCaptureFixture,
) -> None:
    function: Any = lambda odometry, reference: None  # noqa: E731
    hover = ReferenceConfig(trajectory="hover")
    flight: Flight = simulate(reference=hover, controller=function, duration=0.1)
    assert len(flight.time) == 5 and len(flight.commands.throttle) == 0
    assert np.all(flight.p_WB == 0.0)
    assert summarise(flight)["commands"] == 0
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "command: given None, expected CommandSample" in caplog.text
