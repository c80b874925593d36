"""Nodes as processes of their own, and a node of the test's to talk with them."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node


@contextmanager
def _node_process(name: str, *arguments: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node; it is ended by SIGINT at the end of the block, by force if need be."""
    command = [sys.executable, "-m", f"quad_mpc_ros.nodes.{name}_node", "--ros-args", *arguments]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Peer:
    """A node of the test's, spun only while the test waits."""

    def __init__(self) -> None:
        rclpy.init()
        self.node: Node = rclpy.create_node("test_peer")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.shutdown()

    def wait(self, condition: Callable[[], object], timeout: float = 15.0) -> bool:
        """Spin until something is true; return whether it became so in time."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def spin(self, seconds: float) -> None:
        self.wait(lambda: False, timeout=seconds)

    def call(self, client: Any, request: Any) -> Any:
        assert self.wait(client.service_is_ready)
        future = client.call_async(request)
        assert self.wait(future.done)
        return future.result()


@pytest.fixture
def peer() -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Start nodes by name and ROS arguments; they end with the test. Logs: tmp_path/<name>.log."""
    with ExitStack() as stack:

        def start_node(name: str, *arguments: str) -> subprocess.Popen[bytes]:
            log = tmp_path / f"{name}.log"
            return stack.enter_context(_node_process(name, *arguments, log=log))

        yield start_node
