# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Shutdown of nodes of the command line."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest


def ran(program: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-c", program]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


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
    result = ran(_INTERRUPTED.format(message_info=message_info))

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
    result = ran(_ENDED)

    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines() == ["True", "[]"]


_SWALLOWED = """
import ctypes, signal, sys
from quad_mpc_ros.ros import spin

def create():
    ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.{name}))()
    while True:
        pass

sys.exit(spin.run(create))
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_signal_in_a_callback_of_c_interrupts_a_start_that_inherits_sigint_ignored(
    name: str,
) -> None:
    """A shell without job control starts background processes so; Python cannot raise there."""
    ignoring = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    result = ran(ignoring + _SWALLOWED.format(name=name))

    assert (result.returncode, result.stderr) == (130, "")


_BEGUN = """
import signal, sys
from rclpy.node import Node
from quad_mpc_ros.ros import spin

class Begun(Node):
    def begin(self):
        signal.raise_signal(signal.SIGTERM)

sys.exit(spin.run(lambda: Begun("begun")))
"""


def test_a_signal_from_the_first_published_message_on_is_exit_code_0() -> None:
    result = ran(_BEGUN)

    assert (result.returncode, result.stderr) == (0, "")


_SPENT = """
import sys, time
from quad_mpc_ros.ros import spin
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode

class Ending(MpcNode):
    def begin(self):
        super().begin()
        self.create_timer(0.1, self.end)

    def end(self):
        print(time.process_time())
        spin.stop()

sys.argv[1:] = []
sys.exit(spin.run(Ending))
"""


def test_shutdown_is_much_faster_than_startup() -> None:
    """The times are processor times; with a garbage collection it was more than a third."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)

    result = ran(_SPENT)

    assert result.returncode == 0, result.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    start = float(result.stdout)
    assert spent - start < 0.15 * start


_REGISTERING = """
import signal, sys, time
from rclpy.event_handler import EventHandler
from rclpy.node import Node
from std_msgs.msg import Int32
from quad_mpc_ros.ros import spin

register, count = EventHandler.add_to_wait_set, 0

def registering(self, wait_set):
    global count
    count += 1
    if count == 2:
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.3)
    register(self, wait_set)

EventHandler.add_to_wait_set = registering

def create():
    node = Node("registered")
    node.kept = [node.create_subscription(Int32, name, print, 1) for name in "ab"]
    return node

sys.exit(spin.run(create, message_info={message_info}))
"""


@pytest.mark.parametrize("message_info", [False, True])
def test_a_signal_while_the_executor_registers_a_node_is_exit_code_0(message_info: bool) -> None:
    """An events executor that registers while ROS ends aborts the process."""
    result = ran(_REGISTERING.format(message_info=message_info))

    assert (result.returncode, result.stderr) == (0, "")
