# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a process imports: who needs no compiled code has no compiler in its memory."""

from __future__ import annotations

import subprocess
import sys

import pytest
from fixtures.setup_py import declared

HEAVY = ("numba", "llvmlite", "scipy", "osqp")

WITHOUT = [
    "import quad_mpc_ros",
    *(
        f"import quad_mpc_ros.ros.nodes.{node}_node"
        for node in ("recorder", "visualisation", "player", "reference")
    ),
    *(
        "from quad_mpc_ros.ros.bridges import node, registry; "
        f"registry.load_bridge('{name.removesuffix('_bridge')}')"
        for name in declared("quad_mpc_ros.bridges")
    ),
    "from quad_mpc_ros import cli\ntry: cli.main(['--help'])\nexcept SystemExit: pass",
]


@pytest.mark.parametrize("code", WITHOUT)
def test_imports_no_compiler_and_no_solver(code: str) -> None:
    assert imported_by(code) == []


def test_the_simulator_imports_no_solver() -> None:
    assert "osqp" not in imported_by("import quad_mpc_ros.ros.nodes.simulator_node")


def imported_by(code: str) -> list[str]:
    """Return which of the heavy packages a process has imported after some code."""
    asked = f"{code}\nimport sys\nprint('imported', *({{*{HEAVY}}} & sys.modules.keys()))"
    ended = subprocess.run(
        [sys.executable, "-c", asked], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.splitlines()[-1].split()[1:]
