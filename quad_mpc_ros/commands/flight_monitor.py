"""Watching a flight from the process that started it: are its nodes connected, how far is it."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Self

from std_srvs.srv import Trigger

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.commands.processes import FlightError, NodeProcess
from quad_mpc_ros.commands.progress import ProgressLine
from quad_mpc_ros.configuration.compilation import cached_functions
from quad_mpc_ros.messages.diagnostics import PEERS_KEY
from quad_mpc_ros.messages.topics import (
    BATTERY,
    CLOCK,
    COMMAND,
    DIAGNOSTICS,
    IMU,
    ODOMETRY,
    PREDICTED_PATH,
    REFERENCE,
    REFERENCE_PATH,
    STATS,
)
from quad_mpc_ros.ros.command_ownership import DISCOVERING
from quad_mpc_ros.ros.messages import odometry_in

# The first start after an installation compiles, on a small computer for minutes.
_READY_TIMEOUT = 240.0
_WAIT_LOG_DELAY = 5.0
# How many peers an endpoint must have matched before the clock starts, by node and topic.
# Publishers count subscribers: the odometry's are mpc, reference, recorder and this monitor.
# Subscribers count publishers, of which there must be exactly one.
_REQUIRED_PEERS: dict[str, dict[str, int]] = {
    "simulator": {ODOMETRY.name: 4, COMMAND.name: 1},
    "reference": {REFERENCE.name: 2, REFERENCE_PATH.name: 1, ODOMETRY.name: 1},
    "mpc": {
        COMMAND.name: 2,
        STATS.name: 1,
        PREDICTED_PATH.name: 1,
        ODOMETRY.name: 1,
        REFERENCE.name: 1,
    },
    "recorder": {
        topic.name: 1
        for topic in (ODOMETRY, REFERENCE, COMMAND, PREDICTED_PATH, REFERENCE_PATH, STATS)
    },
}
_DUPLICATE_TEXTS = {
    "simulator": (COMMAND.name,),
    "mpc": (ODOMETRY.name, REFERENCE.name),
    "reference": (ODOMETRY.name,),
}
# In lockstep mpc, reference and recorder follow the clock, and the recorder records it.
_CLOCK_PEERS = 4


def _expected(
    recorded: Collection[str] | None, *, watched: bool, together: bool
) -> dict[str, dict[str, int]]:
    """Return the peers of a vehicle's endpoints; if ``watched``, the monitor is one of them.

    MPC and reference ``together`` in one process need no DDS.
    """
    peers = {node: dict(topics) for node, topics in _REQUIRED_PEERS.items()}
    if together:
        del peers["mpc"][REFERENCE.name]
        peers["reference"][REFERENCE.name] -= 1
    if not watched:
        peers["simulator"][ODOMETRY.name] -= 1
    if recorded is not None:
        for name in peers["recorder"].keys() - set(recorded):
            del peers["recorder"][name]
            for topics in (peers["mpc"], peers["reference"]):
                if name in topics:
                    topics[name] -= 1
    return peers


class FlightMonitor(Observer):
    """A small node, spun from the main thread of ``quad_mpc fly``.

    It waits for the vehicles in ``namespaces`` and shows the progress of the first one.
    ``recorded`` are the topics that are, if not all; ``together`` are MPC and reference in one
    process.
    """

    def __init__(
        self,
        *,
        lockstep: bool,
        namespaces: Sequence[str] = ("",),
        recorded: Collection[str] | None = None,
        together: bool = False,
    ) -> None:
        super().__init__("quad_mpc_flight")
        self._prefixes = [f"{namespace}/" if namespace else "" for namespace in namespaces]
        self._recorded = recorded
        self._peers: dict[str, dict[str, int]] = {}
        for prefix in self._prefixes:
            watched = prefix == self._prefixes[0]
            expected = _expected(recorded, watched=watched, together=together)
            for node, topics in expected.items():
                on_bag = node == "recorder"
                self._peers[prefix + node] = {
                    f"/{prefix}{name}" if on_bag else name: count for name, count in topics.items()
                }
        if lockstep:
            self._peers["simulator"][CLOCK.name] = _CLOCK_PEERS
            self._peers["recorder"][CLOCK.name] = 1
        self._health: dict[str, dict[str, str]] = {}
        self._odometry: bytes | None = None
        self._first_ns: int | None = None

    def __enter__(self) -> Self:
        super().__enter__()
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        # Raw: decoded only when progress is shown, not fifty times a second.
        named = dataclasses.replace(ODOMETRY, name=self._prefixes[0] + ODOMETRY.name)
        subscribe(self.node, named, self._on_odometry, raw=True)
        self._starts = [
            self.node.create_client(Trigger, f"{prefix}simulator/start")
            for prefix in self._prefixes
        ]
        return self

    def spin(self, seconds: float) -> None:
        """Handle what has arrived, waiting at most so long for the first of it."""
        self.executor.spin_once(timeout_sec=seconds)

    def ready(self) -> bool:
        """Whether all endpoints are matched and the recorders have the parameters of all nodes."""
        return not self.missing() and all(start.service_is_ready() for start in self._starts)

    def missing(self) -> list[str]:
        """Return what is still to come, as ``node: topic``."""
        missing = []
        for node, topics in self._peers.items():
            health = self._health.get(node, {})
            missing += [
                f"{node}: {topic}"
                for topic, peers in topics.items()
                if int(health.get(f"{PEERS_KEY}{topic}", 0)) < peers
            ]
        for prefix in self._prefixes:
            recorder = self._health.get(f"{prefix}recorder", {})
            missing += [
                f"{prefix}recorder: {topic.name}"
                for topic in (BATTERY, IMU)
                if f"{PEERS_KEY}{topic.name}" in self._health.get(f"{prefix}simulator", {})
                and (self._recorded is None or topic.name in self._recorded)
                and recorder.get(f"{PEERS_KEY}/{prefix}{topic.name}", "0") == "0"
            ]
            # Or it would fly for a while uncommanded.
            if self._health.get(f"{prefix}mpc", {}).get(DISCOVERING) != "false":
                missing.append(f"{prefix}mpc: who else commands")
            if self._health.get(f"{prefix}recorder", {}).get("parameters_missing", "all"):
                missing.append(f"{prefix}recorder: parameters")
        return missing

    def intruders(self) -> str:
        """Return a topic that has more than one publisher, or nothing."""
        for prefix in self._prefixes:
            for node, topics in _DUPLICATE_TEXTS.items():
                for topic in topics:
                    health = self._health.get(prefix + node, {})
                    count = int(health.get(f"{PEERS_KEY}{topic}", 0))
                    if count > 1:
                        return f"{count} publishers on {prefix}{topic}"
        return ""

    def lost(self) -> str:
        """Return what is missing in the bags, empty if nothing is."""
        recorders = (self._health.get(f"{prefix}recorder", {}) for prefix in self._prefixes)
        lost = sum(int(health.get("lost", 0)) for health in recorders)
        if not lost:
            return ""
        return (
            f"{lost} messages were not recorded: the machine was too busy; fly fewer vehicles or "
            "record fewer topics (recorder.topics)"
        )

    def flown(self) -> float:
        """Return the time flown until the latest odometry [s]."""
        if self._odometry is None:
            return 0.0
        stamp_ns = odometry_in(self._odometry).stamp_ns
        if self._first_ns is None:
            self._first_ns = stamp_ns
        return (stamp_ns - self._first_ns) * 1e-9

    def start_simulator(self) -> None:
        """Start the clock of the simulator, or of all of them."""
        for answer in [start.call_async(Trigger.Request()) for start in self._starts]:
            self.executor.spin_until_future_complete(answer, timeout_sec=5.0)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self._health[status.name.removeprefix("/")] = values

    def _on_odometry(self, data: bytes) -> None:
        self._odometry = data


def watch_flight(
    monitor: FlightMonitor, vehicles: Mapping[str, Mapping[str, NodeProcess]], duration: float
) -> float:
    """Wait until all nodes are connected, start the clock, and wait for the end.

    ``vehicles`` are the processes by namespace and node; ``duration`` [s] is that of the flight.
    Returns the seconds flown on the wall clock. Raises :class:`FlightError`.
    """
    _await_readiness(monitor, vehicles)
    monitor.start_simulator()
    flying = {namespace: dict(processes) for namespace, processes in vehicles.items()}
    simulators = [processes.pop("simulator") for processes in flying.values()]
    started, progress = time.monotonic(), ProgressLine()
    while any(simulator.exit_code is None for simulator in simulators):
        monitor.spin(0.05)
        if progress.due:
            progress.show_flight(monitor.flown(), duration)
        for processes in flying.values():
            _drop_ended_recorder(processes)
        _check_alive(flying)
    progress.close()
    if monitor.lost():
        print(f"warning: {monitor.lost()}", file=sys.stderr)
    for simulator in simulators:
        if simulator.exit_code != 0:
            raise FlightError(
                f"the simulator failed (exit code {simulator.exit_code})\n{simulator.last_words()}"
            )
    return time.monotonic() - started


def _await_readiness(
    monitor: FlightMonitor, vehicles: Mapping[str, Mapping[str, NodeProcess]]
) -> None:
    print("  waiting for the nodes to connect", file=sys.stderr, flush=True)
    started = time.monotonic()
    first_start = not cached_functions()
    patient = False
    while not monitor.ready():
        _check_alive(vehicles)
        if monitor.intruders():
            raise FlightError(
                f"{monitor.intruders()}: another flight on this ROS domain; "
                "end it or set ROS_DOMAIN_ID to another number"
            )
        waited = time.monotonic() - started
        if waited > _WAIT_LOG_DELAY and not patient:
            patient = True
            text = f"still waiting for {', '.join(monitor.missing()[:3])}"
            if first_start:
                text = "the first start compiles, which takes a while"
            print(f"  {text}", file=sys.stderr, flush=True)
        if waited > _READY_TIMEOUT:
            raise FlightError(
                f"the nodes did not connect within {_READY_TIMEOUT:g} s, missing: "
                f"{', '.join(monitor.missing())}"
            )
        monitor.spin(0.02)


def _drop_ended_recorder(processes: dict[str, NodeProcess]) -> None:
    """Report a recorder that has ended, whose disk may be full, and fly on without it."""
    recorder = processes.get("recorder")
    if recorder is not None and recorder.exit_code is not None:
        print(
            f"\nerror: {recorder.obituary()}\n  the flight continues", file=sys.stderr, flush=True
        )
        del processes["recorder"]


def _check_alive(vehicles: Mapping[str, Mapping[str, NodeProcess]]) -> None:
    for namespace, processes in vehicles.items():
        for process in processes.values():
            if process.exit_code is not None:
                where = f"{namespace}: " if namespace else ""
                raise FlightError(f"{where}{process.obituary()}")
