# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What records or copies loads no library that it does not use."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("numba", "scipy", "osqp", "matplotlib")


@pytest.mark.parametrize(
    ("modules", "absent"),
    [
        (("recordings.config",), (*HEAVY, "mcap", "rosbags", "zstandard")),
        # The modules of the recorder, the player and quad_mpc bag.
        (
            ("recordings.writer", "recordings.parameters", "recordings.reader"),
            HEAVY,
        ),
        (("recordings.repair", "messages.conversions", "messages.schemas"), HEAVY),
    ],
)
def test_imports_are_light(modules: tuple[str, ...], absent: tuple[str, ...]) -> None:
    code = "import sys\n" + "".join(f"import quad_mpc_ros.{name}\n" for name in modules)
    code += f"print([name for name in {absent} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"
