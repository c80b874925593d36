# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc watch`` with vehicles that fly over DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from fixtures.pseudo_terminal import PseudoTerminal

Start = Callable[..., "subprocess.Popen[bytes]"]
WATCH = [sys.executable, "-m", "quad_mpc_ros.cli", "watch"]


def watched(*options: str) -> str:
    done = subprocess.run([*WATCH, *options], capture_output=True, timeout=60, check=True)
    return done.stdout.decode()


def test_vehicles_are_columns_of_a_table(start: Start, peer: Any, tmp_path: Path) -> None:
    ticks: dict[str, list[DiagnosticArray]] = {"uav1": [], "uav2": []}
    for name, received in ticks.items():
        peer.node.create_subscription(DiagnosticArray, f"{name}/mpc/stats", received.append, 10)
        for node in ("stack", "simulator"):
            start(node, "-r", f"__ns:=/{name}")
    assert peer.wait(lambda: all(len(received) > 50 for received in ticks.values()), timeout=100.0)

    # Without a terminal a table each second, until interrupted.
    shown = tmp_path / "shown.txt"
    with shown.open("wb") as output:
        process = subprocess.Popen(WATCH, stdout=output, stderr=subprocess.PIPE)

    def tables() -> list[list[list[str]]]:
        """Return the words of the lines of each table."""
        texts = shown.read_text().split("vehicle ")[1:]
        return [[line.split() for line in text.splitlines()] for text in texts]

    both = [
        ["/uav1", "/uav2"],
        ["source", "mpc", "mpc"],
        ["mode", "tracking", "tracking"],
        ["node", "simulator", "OK", "OK"],
    ]
    assert peer.wait(lambda: len(tables()) > 3 and all(line in tables()[-2] for line in both)), (
        shown.read_text()
    )
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0
    assert errors == b""

    # One vehicle by name, once.
    table = watched("--once", "--namespace", "uav1")
    assert "uav2" not in table
    assert ["source", "mpc"] in [line.split() for line in table.splitlines()]


def test_a_table_replaces_the_last_one_in_a_terminal_until_ctrl_c() -> None:
    terminal = PseudoTerminal(WATCH)
    try:
        wait_for(lambda: "\x1b[2J" in terminal.shown and "no MPC reports" in terminal.shown)
        terminal.type("\x03")
        assert terminal.process.wait(20) == 0, terminal.shown
        assert "Traceback" not in terminal.shown
    finally:
        terminal.process.kill()
        terminal.close()


def wait_for(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_reports_that_no_vehicle_flies() -> None:
    done = subprocess.run([*WATCH, "--once"], capture_output=True, timeout=60)
    assert done.returncode == 1
    assert b"no MPC reports" in done.stdout
