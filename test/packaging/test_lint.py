# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run the checks of ``make lint`` as tests, so that ``colcon test`` reports style and types."""

from __future__ import annotations

import re
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINT = (ROOT / "Makefile").read_text().partition("\nlint:")[2].partition("\n\n")[0]
COMMANDS = re.findall(r"^\t\$\(IN_VENV\) dev (.+)$", LINT, re.MULTILINE)
assert COMMANDS


@pytest.mark.timeout(900)  # mypy without its cache
@pytest.mark.parametrize("command", COMMANDS)
def test_code_passes(command: str) -> None:
    if shutil.which(command.split()[0]) is None or find_spec("yaml-stubs") is None:
        pytest.skip("not installed: extra dev of setup.py")
    run = subprocess.run(
        ["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
