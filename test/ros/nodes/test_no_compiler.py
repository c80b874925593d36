"""In flight nothing compiles: machine code that is kept serves all that the nodes do."""

from __future__ import annotations

import platform
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped
from rclpy.qos import qos_profile_sensor_data

Start = Callable[..., "subprocess.Popen[bytes]"]

NODES = ["simulator", "mpc", "reference"]


def has_compiler(process: subprocess.Popen[bytes]) -> bool:
    """Return whether LLVM is in the memory of a process: nothing is compiled without it."""
    return "llvmlite" in Path(f"/proc/{process.pid}/maps").read_text()


@pytest.mark.skipif(platform.machine() != "x86_64", reason="elsewhere Numba is in every node")
@pytest.mark.parametrize("trajectory", ["square", "lemniscate"])
def test_nodes_import_no_compiler_with_cached_code(
    trajectory: str, start: Start, peer: Any, tmp_path: Path
) -> None:
    commands: list[TwistStamped] = []
    peer.node.create_subscription(
        TwistStamped, "command", commands.append, qos_profile_sensor_data
    )
    compilers: dict[str, bool] = {}
    for _ in range(2):  # the first flight compiles what nobody has compiled before
        commands.clear()
        processes = {
            node: start(node, "-p", f"trajectory:={trajectory}")
            if node == "reference"
            else start(node)
            for node in NODES
        }
        assert peer.wait(lambda: len(commands) > 150, timeout=90.0)
        compilers = {node: has_compiler(process) for node, process in processes.items()}
        for process in processes.values():
            process.send_signal(signal.SIGINT)
            process.wait(15)
    assert compilers == dict.fromkeys(NODES, False)
