"""Telling that something takes its time, so that nobody takes the node for dead."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.node import Node

from quad_mpc_ros.ros.clocks import Metronome

COMPILING = (
    "compiling: only the first start after an installation takes long, and not even that after "
    "quad_mpc compile"
)
_PERIOD = 3.0


@contextmanager
def told(node: Node, what: str = COMPILING, *, period: float = _PERIOD) -> Iterator[None]:
    """Log every ``period`` seconds what goes on, and how long it has taken, until it is done."""
    begun = time.monotonic()

    def tell() -> None:
        node.get_logger().info(f"{what} ({time.monotonic() - begun:.0f} s so far)")

    metronome = Metronome(period, tell)
    try:
        yield
    finally:
        metronome.stop()
