# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Flights over DDS while processes fail, and the endurance flight of ``make soak``."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.faults.parameter_changes import good_changes
from fixtures.faults.verdict import command_fault, is_home
from fixtures.processes import end, node_of
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.messages.diagnostics import stats_from_message
from quad_mpc_ros.recordings.recording import Recording

Start = Callable[..., "subprocess.Popen[bytes]"]

HEIGHT = 5.0  # m
NODES: dict[str, tuple[str, ...]] = {
    "simulator": (),
    "reference": ("-p", "trajectory:=hover", "-p", f"height:={HEIGHT}"),
    "mpc": (),
}
TICKS = 25  # without another source in between: the MPC is in command

DURATION = float(os.environ.get("SOAK_DURATION", "8"))  # s
GROWTH_MB = 5.0
WARM_UP = 60.0  # s
CHANGE_PERIOD = 1.0  # s


class Flight:
    """The vehicle as the test observes it."""

    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self._sources: list[str] = []
        self._error = float("inf")
        peer.node.create_subscription(DiagnosticArray, "mpc/stats", self._on_stats, 10)
        peer.node.create_subscription(Odometry, "odom", self._on_odometry, qos_profile_sensor_data)

    def hovers(self) -> bool:
        """Return whether the MPC takes command and brings the vehicle to its reference."""
        self._sources.clear()
        return bool(
            self._peer.wait(
                lambda: self._sources[-TICKS:] == ["mpc"] * TICKS and is_home(self._error)
            )
        )

    def _on_stats(self, message: DiagnosticArray) -> None:
        self._sources.append(stats_from_message(message)["source"])

    def _on_odometry(self, message: Odometry) -> None:
        p = message.pose.pose.position
        self._error = float(np.linalg.norm([p.x, p.y, p.z - HEIGHT]))


@pytest.mark.slow
@pytest.mark.parametrize("order", itertools.permutations(NODES), ids=", ".join)
def test_flies_in_whichever_order_the_nodes_start(
    order: tuple[str, ...], start: Start, peer: Any
) -> None:
    flight = Flight(peer)
    for node in order:
        start(node, *NODES[node])
        assert peer.wait(lambda node=node: node in peer.node.get_node_names())
    assert flight.hovers()


@pytest.mark.slow
def test_continues_after_its_process_was_paused(start: Start, peer: Any) -> None:
    flight = Flight(peer)
    processes = {node: start(node, *arguments) for node, arguments in NODES.items()}
    assert flight.hovers()
    processes["mpc"].send_signal(signal.SIGSTOP)
    peer.spin(1.0)
    processes["mpc"].send_signal(signal.SIGCONT)
    assert flight.hovers()


@pytest.mark.slow
def test_continues_after_the_simulator_was_restarted(start: Start, peer: Any) -> None:
    flight = Flight(peer)
    processes = {node: start(node, *arguments) for node, arguments in NODES.items()}
    assert flight.hovers()
    end(processes["simulator"])
    start("simulator")
    assert flight.hovers()


@pytest.mark.timeout(DURATION + 300)
def test_tolerates_lost_odometries_and_changed_parameters(
    peer: Any, managed: Any, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-P", "-m", "quad_mpc_ros.cli", "fly", "--out", str(out)]
    command += ["--reference", "lemniscate", "--duration", str(DURATION)]
    command += ["--set", "simulator.odom_dropout=0.01", "--set", "reference.height=10"]
    flight = subprocess.Popen(command)
    memory: list[tuple[float, float]] = []
    try:
        mpc = managed("mpc")
        assert mpc.reports("active")
        began = time.monotonic()
        for change in good_changes(MpcConfig()):
            peer.wait(lambda: flight.poll() is not None, timeout=CHANGE_PERIOD)
            if (used := _memory_mb(flight.pid)) is None or time.monotonic() - began > DURATION:
                break
            memory.append((time.monotonic() - began, used))
            assert mpc.set(**change.values) == ""
        flight.wait(300)
    finally:
        end(flight)

    summary = json.loads((out / "summary.json").read_text())
    assert summary["crashed"] is False
    ticks = summary["commanding"]["ticks"]
    assert ticks["mpc"] >= 0.9 * sum(ticks.values())
    commands = Recording(out / "bag").run().commands
    assert len(commands) > 0.9 * summary["odometries"]
    assert {command_fault(each.value, MpcConfig()) for each in commands} == {None}
    warm = [used for when, used in memory if when >= min(0.2 * DURATION, WARM_UP)]
    assert warm[-1] - warm[0] < GROWTH_MB


def _memory_mb(fly: int) -> float | None:
    """Return the resident memory [MB] of the MPC that a flight started, None if there is none."""
    mpc = node_of(fly, "mpc_node")
    try:
        status = Path(f"/proc/{mpc}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) * 1.024e-3
    except (OSError, IndexError):
        return None
