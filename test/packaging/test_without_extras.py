# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The product flies without its optional parts, and names the one that something needs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from fixtures.setup_py import ROOT, setup_arguments, write_metadata

# The command that a race needs imports it at once; the others when they are run.
IMPORTS_ALL = """
import importlib, pkgutil, quad_mpc_ros
for module in pkgutil.walk_packages(quad_mpc_ros.__path__, "quad_mpc_ros."):
    if module.name != "quad_mpc_ros.commands.plan":
        importlib.import_module(module.name)
print("imported", quad_mpc_ros.__file__)
"""
OBSTACLES = "obstacles:\n  - {shape: sphere, position: [3.0, 3.0, 2.0], radius: 0.2}\n"


@pytest.fixture(scope="module")
def product(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of the search path with the package as it is without ``extras``."""
    folder = tmp_path_factory.mktemp("product")
    shutil.copytree(
        ROOT / "quad_mpc_ros",
        folder / "quad_mpc_ros",
        ignore=shutil.ignore_patterns("extras", "__pycache__"),
    )
    shutil.copytree(ROOT / "config", folder / "config")
    shutil.copy(ROOT / "package.xml", folder)
    write_metadata(folder, "quad_mpc_ros", setup_arguments()["entry_points"])
    (folder / "obstacles.yaml").write_text(OBSTACLES)
    return folder


def in_product(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python on the copy, uncompiled: compiling for a new place takes minutes."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_DISABLE_JIT": "1"}
    return subprocess.run(
        [sys.executable, "-P", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=environment,
    )


def test_flies_without_extras(product: Path) -> None:
    command = ("-m", "quad_mpc_ros.cli", "simulate", "--duration", "2", "--out", "run")
    ended = in_product(product, *command)
    assert ended.returncode == 0, ended.stderr
    assert (product / "run" / "summary.json").is_file()


def test_imports_without_extras(product: Path) -> None:
    ended = in_product(product, "-c", IMPORTS_ALL)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == ["imported", str(product / "quad_mpc_ros" / "__init__.py")]


@pytest.mark.parametrize(
    "command",
    [
        "simulate --obstacles obstacles.yaml",
        "simulate --set mpc.obstacles.half_spaces=4",
        "simulate --set simulator.obstacles.file=obstacles.yaml",
        "simulate --plant mujoco",
        "simulate --plant betaflight",
        "simulate --plant rotorpy",
        "simulate --gates split_s",
        "simulate --reference gates",
        "check-reference --gates split_s",
        "plan split_s",
        "campaign robustness",
        "tune robustness",
        "rehearse",
    ],
)
def test_names_the_missing_extra_in_one_line(product: Path, command: str) -> None:
    ended = in_product(product, "-m", "quad_mpc_ros.cli", *command.split())
    (line,) = [each for each in ended.stderr.splitlines() if not each.startswith("simulating")]
    assert line.startswith("error: ")
    assert "needs the optional part" in line
    assert "quad_mpc_ros.extras" in line
    assert ended.returncode == 2


def test_names_the_missing_bridge_in_one_line(product: Path) -> None:
    ended = in_product(product, "-m", "quad_mpc_ros.entry", "crazyflie_bridge")
    (line,) = ended.stderr.splitlines()
    assert "crazyflie_bridge = quad_mpc_ros.extras.bridges.crazyflie" in line
    assert ended.returncode == 2
