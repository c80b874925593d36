"""A node that takes long says so."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

from quad_mpc_ros.ros.clocks import COMPILING, progress_logged


def test_logs_progress_until_done() -> None:
    lines: list[str] = []
    node: Any = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=lines.append))
    with progress_logged(node, period=0.02):
        deadline = time.monotonic() + 10.0
        while len(lines) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert len(lines) >= 3
    assert all(line.startswith(COMPILING) for line in lines)
    after = len(lines)
    time.sleep(0.1)
    assert len(lines) == after
