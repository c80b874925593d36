# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measure the time of a bridge from the arrival of a command to the published message.

python bench/bridge.py [--seconds S] [--rate R]

The rates bridge, whose messages are installed with ROS, takes commands over DDS from another
process, and publishes to a subscriber that is there. Its callback is timed: the whole of it, and
without ROS's publishing, which leaves decoding, clock, checks, units, and message; by the clock,
and by the processor, which stands still while another process runs. A relay, which publishes what
it receives and does nothing else, is timed before and after it, for the part of ROS and machine.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import TwistStamped
from numpy.typing import ArrayLike
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from quad_mpc_ros.ros.bridges.bridge import OutgoingMessage
from quad_mpc_ros.ros.bridges.node import BridgeNode
from quad_mpc_ros.ros.bridges.rates import RatesBridge


class Stopwatch:
    """Times of each command [s]: wall clock, processor, and publishing."""

    def __init__(self) -> None:
        self.clock: list[float] = []
        self.processor: list[float] = []
        self.publishing: list[float] = []

    @contextmanager
    def timing(self) -> Iterator[None]:
        """Time a command."""
        clock, processor = time.perf_counter(), time.thread_time()
        yield
        self.processor.append(time.thread_time() - processor)
        self.clock.append(time.perf_counter() - clock)

    @contextmanager
    def timing_publishing(self) -> Iterator[None]:
        """Time what ROS does of it."""
        clock = time.perf_counter()
        yield
        self.publishing.append(time.perf_counter() - clock)


class TimedBridge(BridgeNode):
    """The rates bridge, engaged."""

    def __init__(self) -> None:
        self.stopwatch = Stopwatch()
        super().__init__(RatesBridge)
        self._bridge.engage(True, now_ns=self._now_ns())

    def _on_command(self, message: Any) -> None:
        with self.stopwatch.timing():
            super()._on_command(message)

    def _send(self, outgoing: OutgoingMessage) -> None:
        with self.stopwatch.timing_publishing():
            super()._send(outgoing)


class TimedRelay(Node):
    """Publishes the commands that it receives."""

    def __init__(self) -> None:
        super().__init__("bench_relay")
        self.stopwatch = Stopwatch()
        self._setpoints = self.create_publisher(TwistStamped, "rates_setpoint", 10)
        self.create_subscription(
            TwistStamped, "command", self._on_command, qos_profile_sensor_data
        )

    def _on_command(self, message: TwistStamped) -> None:
        with self.stopwatch.timing(), self.stopwatch.timing_publishing():
            self._setpoints.publish(message)


def command_and_listen(rate: float, stopping: Any) -> None:
    """Publish commands, and subscribe to the setpoints as a stack does."""
    rclpy.init()
    node = rclpy.create_node("bench_peer")
    publisher = node.create_publisher(TwistStamped, "command", qos_profile_sensor_data)
    node.create_subscription(TwistStamped, "rates_setpoint", lambda message: None, 10)

    def publish() -> None:
        command = TwistStamped()
        command.header.stamp = node.get_clock().now().to_msg()
        command.twist.linear.z, command.twist.angular.y = 0.3, 0.5
        publisher.publish(command)

    node.create_timer(1.0 / rate, publish)
    while not stopping.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)


def main() -> None:
    """Time a bridge for a while."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="for each of the three")
    parser.add_argument("--rate", type=float, default=50.0, help="commands per second")
    options = parser.parse_args()
    fresh = multiprocessing.get_context("spawn")
    stopping = fresh.Event()
    peer = fresh.Process(target=command_and_listen, args=(options.rate, stopping))
    peer.start()
    rclpy.init()
    for kind in (TimedRelay, TimedBridge, TimedRelay):
        measure(kind, options.seconds)
    stopping.set()
    peer.join()
    rclpy.shutdown()


def measure(kind: type[TimedBridge | TimedRelay], seconds: float) -> None:
    """Spin a node for a while and print how long it took for its commands."""
    node = kind()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    ended = time.monotonic() + seconds
    while time.monotonic() < ended:
        executor.spin_once(timeout_sec=0.1)
    node.destroy_node()
    watch = node.stopwatch
    if len(watch.clock) != len(watch.publishing) or not watch.clock:
        raise SystemExit(f"{kind.__name__}: {len(watch.publishing)} of {len(watch.clock)} passed")
    print(f"{kind.__name__}, {len(watch.clock)} commands", flush=True)
    show("whole", watch.clock)
    show("without publishing", np.subtract(watch.clock, watch.publishing))
    show("processor, whole", watch.processor)


def show(what: str, taken: ArrayLike) -> None:
    """Print percentiles of times [s]."""
    p50, p99, most = 1e3 * np.percentile(taken, [50, 99, 100])
    print(f"  {what:18}  p50 {p50:.3f}  p99 {p99:.3f}  max {most:.3f} ms", flush=True)


if __name__ == "__main__":
    main()
