# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Log the progress of a compilation, which takes up to a minute."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.node import Node

from quad_mpc_ros.configuration.compilation import functions_compiled
from quad_mpc_ros.ros.clocks import Metronome

_LOG_PERIOD = 3.0  # s


@contextmanager
def log_compilation(node: Node, *, period: float = _LOG_PERIOD) -> Iterator[None]:
    """Log the number of compiled functions every ``period`` seconds and at the end."""
    begun, before = time.monotonic(), functions_compiled()

    def made() -> str:
        return f"{functions_compiled() - before} functions in {time.monotonic() - begun:.0f} s"

    metronome = Metronome(period, lambda: node.get_logger().info(f"compiling: {made()} so far"))
    try:
        yield
    finally:
        metronome.stop()
    if functions_compiled() > before:
        node.get_logger().warning(
            f"compiled {made()} that were not in the compile cache: run 'quad_mpc compile' "
            "once, so that nodes start without compiling"
        )
