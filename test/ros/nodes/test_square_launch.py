# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run ``square.launch.py`` with ``launch_testing``, where launch is installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

TEST = Path(__file__).parents[2] / "fixtures" / "square_launch.py"


def test_square_launch_flies_and_ends() -> None:
    """In a process of its own, because launch leaves its event loop open."""
    pytest.importorskip("launch_testing")
    command = [sys.executable, "-m", "launch_testing.launch_test", str(TEST)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
