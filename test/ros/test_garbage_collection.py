# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Garbage collection between control steps, in a separate process because it cannot be undone."""

from __future__ import annotations

import subprocess
import sys

_PROGRAM = """
import gc
from quad_mpc_ros.ros.garbage_collection import GarbageCollection

garbage = GarbageCollection()
before = gc.get_stats()[2]["collections"]
for _ in range(100):
    garbage.after_tick()
print(gc.get_stats()[2]["collections"] - before, gc.isenabled())
"""


def test_collects_garbage_between_ticks_only() -> None:
    result = subprocess.run(
        [sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True, timeout=60
    )
    assert result.stdout.split() == ["2", "False"]
