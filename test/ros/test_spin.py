"""How a node of the command line ends."""

from __future__ import annotations

import subprocess
import sys

import pytest

_INTERRUPTED = """
import signal, sys, weakref
from rclpy.node import Node
from quad_mpc_ros.ros import spin

executor, uninstall = spin.fastest_executor, spin.uninstall_signal_handlers

def observed_executor(*, message_info):
    made = executor(message_info=message_info)
    weakref.finalize(made, print, "executor freed")
    return made

def observed_uninstall():
    uninstall()
    print("signal thread ended")

def create():
    node = Node("interrupted")
    node.create_timer(0.1, lambda: signal.raise_signal(signal.SIGINT))
    return node

spin.fastest_executor = observed_executor
spin.uninstall_signal_handlers = observed_uninstall
sys.exit(spin.run(create, message_info={message_info}))
"""


@pytest.mark.parametrize("message_info", [False, True])
def test_executor_outlives_the_signal_thread(message_info: bool) -> None:
    """rclpy's signal thread reads the list of executors without a lock."""
    program = _INTERRUPTED.format(message_info=message_info)

    result = subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, timeout=60
    )

    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines() == ["signal thread ended", "executor freed"]


_ENDED = """
import os, sys
from pathlib import Path
from quad_mpc_ros.ros import spin
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode

class Ending(ReferenceNode):
    def __init__(self):
        super().__init__()
        self.create_timer(0.1, spin.stop)

def of_dds():
    names = [path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")]
    # One that watches shared memory is of the library, not of a participant.
    return [name for name in names if name.startswith("dds.") and name != "dds.shm.wdog"]

def create():
    node = Ending()
    print(len(of_dds()) > 0)
    return node

sys.argv[1:] = []
code = spin.run(create)
print(of_dds())
sys.exit(code)
"""


def test_no_thread_of_dds_is_left_when_a_process_ends() -> None:
    """One that outlives what it calls aborts the process: ``pure virtual method called``."""
    result = subprocess.run(
        [sys.executable, "-P", "-c", _ENDED], capture_output=True, text=True, timeout=60
    )

    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines() == ["True", "[]"]
