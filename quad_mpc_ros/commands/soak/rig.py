"""Simulator, reference and MPC as processes, and a node among them that watches and relays."""

from __future__ import annotations

import functools
import signal
import sys
import time
from collections.abc import Callable
from typing import Any, Self

import numpy as np
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.commands.processes import NodeProcess
from quad_mpc_ros.commands.run_configuration import RunConfig
from quad_mpc_ros.commands.soak.relay import PREFIX, odometry_relay, reference_relay
from quad_mpc_ros.commands.soak.watch import Watch, resident_memory
from quad_mpc_ros.experiments.faults.parameter_changes import Change
from quad_mpc_ros.experiments.faults.verdict import is_home
from quad_mpc_ros.messages.topics import DIAGNOSTICS, ODOMETRY, REFERENCE
from quad_mpc_ros.recordings.evaluation.crash import MotionLog
from quad_mpc_ros.ros.commanders import DISCOVERING

NODES = ("simulator", "reference", "mpc")
# The first start after an installation compiles, on a small computer for minutes.
_READY_TIMEOUT = 240.0
_SETTLE_TIMEOUT = 30.0
_SPIN = 0.005
_POSITION_PERIOD = 0.05
_MEMORY_PERIOD = 1.0


class SoakError(Exception):
    """The soak could not continue; the message says why."""


class Rig(Observer):
    """The processes of a soak, and this process's node.

    With ``relays`` the MPC receives odometry and reference through this process, and its solver
    and its clock fail on demand; without, it is the node as it flies.
    """

    def __init__(self, run: RunConfig, *, relays: bool) -> None:
        super().__init__("quad_mpc_soak")
        self._run, self._relays = run, relays
        self.processes: dict[str, NodeProcess] = {}
        self.memory: list[tuple[int, int]] = []
        """When, by the system's clock [ns], the MPC's process took how much memory [bytes]."""
        self._memory_due = 0.0
        self.stall = 0.0
        """Longest time [s] for which the machine kept this process from looking; may be reset."""
        self.motion = MotionLog()
        """Where vehicle and reference were since the flight began; seconds since then."""
        self._began = time.monotonic()
        self._position_error: float | None = None
        self._position_due = 0.0
        self._discovering = True  # the MPC: who else commands

    def __enter__(self) -> Self:
        super().__enter__()
        self.odometry = odometry_relay(self.node)
        self.reference = reference_relay(self.node)
        self.watch = Watch(self.node, self._run.mpc)
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        self._parameters = self.node.create_client(
            SetParametersAtomically, "mpc/set_parameters_atomically"
        )
        self._simulator = self.node.create_client(Trigger, "simulator/start")
        return self

    def __exit__(self, *error: object) -> None:
        for process in self.processes.values():
            process.send(signal.SIGCONT)
            process.stop()
        super().__exit__(*error)

    def start(self, node: str, **overrides: Any) -> None:
        """Start a node, with parameters that win over those of the run."""
        module, remaps = None, {}
        if node == "mpc" and self._relays:
            module = "commands.soak.mpc_with_faults"
            remaps = {topic.name: PREFIX + topic.name for topic in (ODOMETRY, REFERENCE)}
        self.processes[node] = NodeProcess(
            node, run=self._run, module=module, remaps=remaps, overrides=overrides
        )

    def stop(self, node: str) -> None:
        """End a node while the others continue."""
        process = self.processes.pop(node)
        process.send(signal.SIGINT)
        self.wait(lambda: process.exit_code is not None, f"the end of {node}")

    def fly(self) -> None:
        """Start all nodes, start the clock when they are connected, await the reference."""
        print("  waiting for the nodes to connect", file=sys.stderr, flush=True)
        for node in NODES:
            self.start(node)
        self.wait(self._connected, "the nodes to connect", timeout=_READY_TIMEOUT)
        self.wait(lambda: not self._discovering, "the MPC to know who else commands")
        self.call(self._simulator, Trigger.Request())
        self.motion.clear()  # the flight begins now: towards its reference it may swing
        self._began = time.monotonic()
        self.settle()

    def settle(self) -> None:
        """Wait until the MPC flies and the vehicle is at its reference."""
        self.wait(
            lambda: self.watch.source_for(0.3) == "mpc" and self.home,
            "the vehicle to come to its reference",
            timeout=_SETTLE_TIMEOUT,
        )

    @property
    def home(self) -> bool:
        """Whether the vehicle is at its reference."""
        return self.position_error is not None and is_home(self.position_error)

    @property
    def position_error(self) -> float | None:
        """Distance from the reference [m], updated now and then."""
        return self._position_error

    def spin(self, seconds: float) -> None:
        """Relay and watch for a time."""
        self._spin_until(lambda: False, seconds)

    def wait(self, condition: Callable[[], object], what: str, *, timeout: float = 20.0) -> None:
        """Relay and watch until something is true; raises :class:`SoakError` if it never is."""
        if not self._spin_until(condition, timeout):
            raise SoakError(f"waited {timeout:g} s for {what}, which did not happen")

    def call(self, client: Any, request: Any) -> Any:
        """Call a service and return its response."""
        self.wait(client.service_is_ready, f"the service {client.srv_name}")
        future = client.call_async(request)
        self.wait(future.done, f"the answer of {client.srv_name}")
        return future.result()

    def switch(self, fault: str, on: bool) -> None:
        """Let the MPC's solver or clock fail, or no longer."""
        self.call(self._switch_client(fault), SetBool.Request(data=on))

    def set_parameters(self, change: Change) -> Any:
        """Ask the MPC for a change of parameters; the future holds whether it was made."""
        request = SetParametersAtomically.Request()
        request.parameters = [
            Parameter(name, value=value).to_parameter_msg()
            for name, value in change.values.items()
        ]
        return self._parameters.call_async(request)

    @functools.cache  # noqa: B019 a rig lives as long as its process
    def _switch_client(self, fault: str) -> Any:
        return self.node.create_client(SetBool, f"mpc/fault/{fault}")

    def _connected(self) -> bool:
        matched = not self._relays or (self.odometry.matched and self.reference.matched)
        publishers = [self.node.count_publishers(topic.name) for topic in (ODOMETRY, REFERENCE)]
        if max(publishers) > 1:
            raise SoakError(
                "another flight on this ROS domain; end it or set ROS_DOMAIN_ID to another number"
            )
        return (
            matched
            and self.watch.connected
            and min(publishers) == 1
            and bool(self._simulator.service_is_ready())
            and bool(self._parameters.service_is_ready())
        )

    def _spin_until(self, condition: Callable[[], object], seconds: float) -> bool:
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() >= end:
                return False
            began = time.monotonic()
            self.executor.spin_once(timeout_sec=_SPIN)
            self.stall = max(self.stall, time.monotonic() - began - _SPIN)
            for relay in (self.odometry, self.reference):
                relay.release()
            self._check_alive()
            self._sample_memory()
            self._sample_motion()
        return True

    def _sample_motion(self) -> None:
        """Sample vehicle and reference now and then."""
        if time.monotonic() < self._position_due:
            return
        self._position_due = time.monotonic() + _POSITION_PERIOD
        odometry, window = self.odometry.last, self.reference.last
        if odometry is not None and window is not None:
            p, q = window.pose_at(odometry.stamp_ns)
            self._position_error = float(np.linalg.norm(p - odometry.p_WB))
            elapsed = time.monotonic() - self._began
            self.motion.add(elapsed, (odometry.p_WB, odometry.q_WB_xyzw), (p, q))

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            for pair in status.values:
                if pair.key == DISCOVERING:
                    self._discovering = pair.value == "true"

    def _sample_memory(self) -> None:
        """Sample the memory now and then."""
        if "mpc" in self.processes and time.monotonic() >= self._memory_due:
            self._memory_due = time.monotonic() + _MEMORY_PERIOD
            memory = resident_memory(self.processes["mpc"].pid)
            if memory is not None:
                self.memory.append((time.time_ns(), memory))

    def _check_alive(self) -> None:
        for process in self.processes.values():
            if process.exit_code is not None:
                raise SoakError(process.obituary())
