"""A node that has to compile says so, for it takes most of a minute."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.node import Node

from quad_mpc_ros.configuration.compilation import functions_compiled
from quad_mpc_ros.ros.clocks import Metronome

_PERIOD = 3.0  # s


@contextmanager
def reported(node: Node, *, period: float = _PERIOD) -> Iterator[None]:
    """Log how many functions have been compiled, every ``period`` seconds and in the end."""
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
            f"compiled {made()}, which were not in the compile cache: run 'quad_mpc compile' once "
            "for all nodes and starts"
        )
