"""A node that takes long says so."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

from quad_mpc_ros.ros.telling import COMPILING, told


def test_what_takes_long_is_told_again_and_again_and_then_no_more() -> None:
    lines: list[str] = []
    node: Any = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=lines.append))
    with told(node, period=0.02):
        deadline = time.monotonic() + 10.0
        while len(lines) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert len(lines) >= 3
    assert all(line.startswith(COMPILING) for line in lines)
    after = len(lines)
    time.sleep(0.1)
    assert len(lines) == after
