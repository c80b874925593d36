# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of a flight: connections of the nodes, progress, early ends."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any, Self

from std_srvs.srv import Trigger

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.commands.processes import FlightError, NodeProcess
from quad_mpc_ros.commands.progress import ProgressLine
from quad_mpc_ros.configuration.compilation import cached_functions
from quad_mpc_ros.messages import topics
from quad_mpc_ros.messages.diagnostics import PEERS_KEY
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.command_ownership import DISCOVERING
from quad_mpc_ros.ros.messages import odometry_in

# The first start after an installation compiles, which takes minutes on a small computer.
_READY_TIMEOUT = 240.0
_WAIT_LOG_DELAY = 5.0
# Publisher and subscribers of the topics of a flight, which the recorder also subscribes to.
_FLOW: dict[Topic, tuple[str, tuple[str, ...]]] = {
    topics.ODOMETRY: ("simulator", ("mpc", "reference")),
    topics.COMMAND: ("mpc", ("simulator",)),
    topics.REFERENCE: ("reference", ("mpc",)),
    topics.REFERENCE_PATH: ("reference", ()),
    topics.STATS: ("mpc", ()),
    topics.PREDICTED_PATH: ("mpc", ()),
}
# In lockstep mpc, reference and recorder follow the clock, and the recorder records it.
_CLOCK_PEERS = 4


def _required_peers(*, lockstep: bool) -> Counter[tuple[str, str]]:
    """Return the peers that each endpoint needs, by node and topic.

    Publishers count subscribers. Subscribers count publishers, of which there must be one.
    """
    required: Counter[tuple[str, str]] = Counter()
    for topic, (publisher, subscribers) in _FLOW.items():
        for subscriber in subscribers:
            required[subscriber, topic.name] = 1
        required[publisher, topic.name] = len(subscribers) + 1  # and the recorder
        # The recorder reports topics with their full names.
        required["recorder", f"/{topic.name}"] = 1
    required["simulator", topics.ODOMETRY.name] += 1  # the monitor
    if lockstep:
        required["simulator", topics.CLOCK.name] = _CLOCK_PEERS
        required["recorder", topics.CLOCK.name] = 1
    return required


class FlightMonitor(Observer):
    """A node that is spun from the main thread of ``quad_mpc fly``."""

    def __init__(self, *, lockstep: bool) -> None:
        super().__init__("quad_mpc_flight")
        self._required = _required_peers(lockstep=lockstep)
        self._health: dict[str, dict[str, str]] = {}
        self._odometry: bytes | None = None
        self._first_ns: int | None = None

    def __enter__(self) -> Self:
        super().__enter__()
        subscribe(self.node, topics.DIAGNOSTICS, self._on_diagnostics)
        # Raw, because it is decoded only for the progress, not fifty times a second.
        subscribe(self.node, topics.ODOMETRY, self._on_odometry, raw=True)
        self._start = self.node.create_client(Trigger, "simulator/start")
        return self

    def spin(self, seconds: float) -> None:
        """Handle received messages, waiting at most ``seconds`` for the first one."""
        self.executor.spin_once(timeout_sec=seconds)

    def ready(self) -> bool:
        """Whether all endpoints are matched and the recorder has the parameters of all nodes."""
        return not self.missing() and self._start.service_is_ready()

    def missing(self) -> list[str]:
        """Return the missing connections as ``node: topic``."""
        missing = [
            f"{node}: {topic}"
            for (node, topic), count in self._required.items()
            if self._matched(node, topic) < count
        ]
        missing += [
            f"recorder: {topic.name}"
            for topic in (topics.BATTERY, topics.IMU)
            if f"{PEERS_KEY}{topic.name}" in self._health.get("simulator", {})
            and not self._matched("recorder", f"/{topic.name}")
        ]
        # Until it knows the other publishers of commands, the MPC publishes none.
        if self._health.get("mpc", {}).get(DISCOVERING) != "false":
            missing.append("mpc: other publishers of commands")
        if self._health.get("recorder", {}).get("parameters_missing", "all"):
            missing.append("recorder: parameters")
        return missing

    def duplicate_publishers(self) -> str:
        """Return a topic that has more than one publisher, or an empty string."""
        for topic, (_, subscribers) in _FLOW.items():
            for node in subscribers:
                count = self._matched(node, topic.name)
                if count > 1:
                    return f"{count} publishers on {topic.name}"
        return ""

    def lost_messages(self) -> int:
        """Return the number of messages that the recorder has lost."""
        return int(self._health.get("recorder", {}).get("lost", 0))

    def flown(self) -> float:
        """Return the time flown until the latest odometry [s]."""
        if self._odometry is None:
            return 0.0
        stamp_ns = odometry_in(self._odometry).stamp_ns
        if self._first_ns is None:
            self._first_ns = stamp_ns
        return (stamp_ns - self._first_ns) * 1e-9

    def start_simulator(self) -> None:
        """Start the clock of the simulator."""
        answer = self._start.call_async(Trigger.Request())
        self.executor.spin_until_future_complete(answer, timeout_sec=5.0)

    def _matched(self, node: str, topic: str) -> int:
        """Return the number of peers of an endpoint, as the node reports it."""
        return int(self._health.get(node, {}).get(f"{PEERS_KEY}{topic}", 0))

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self._health[status.name.removeprefix("/")] = values

    def _on_odometry(self, data: bytes) -> None:
        self._odometry = data


def watch_flight(
    monitor: FlightMonitor, nodes: Mapping[str, NodeProcess], duration: float
) -> float:
    """Wait until all nodes are connected, start the clock, and wait for the end.

    ``duration`` [s] is the flight's. Returns the seconds flown on the wall clock. Raises
    :class:`FlightError`.
    """
    _await_readiness(monitor, nodes.values())
    monitor.start_simulator()
    others = dict(nodes)
    simulator = others.pop("simulator")
    started, progress = time.monotonic(), ProgressLine()
    while not simulator.has_ended:
        monitor.spin(0.05)
        progress.show_flight(monitor.flown(), duration)
        if "recorder" in others and others["recorder"].has_ended:
            # For example on a full disk: the flight continues without it.
            text = f"\nerror: {others.pop('recorder').unexpected_end()}\n  the flight continues"
            print(text, file=sys.stderr, flush=True)
        _check_alive(others.values())
    progress.close()
    if lost := monitor.lost_messages():
        print(
            f"warning: {lost} messages were not recorded because the computer was too busy; "
            "record fewer topics (recorder.topics)",
            file=sys.stderr,
        )
    if simulator.exit_code != 0:
        raise FlightError(
            f"the simulator failed (exit code {simulator.exit_code})\n{simulator.log_tail()}"
        )
    return time.monotonic() - started


def _await_readiness(monitor: FlightMonitor, processes: Iterable[NodeProcess]) -> None:
    print("  waiting for the nodes to connect", file=sys.stderr, flush=True)
    started = time.monotonic()
    first_start = not cached_functions()
    logged = False
    while not monitor.ready():
        _check_alive(processes)
        if duplicate := monitor.duplicate_publishers():
            raise FlightError(
                f"{duplicate}: another flight runs in this ROS domain; stop that flight or set "
                "ROS_DOMAIN_ID to another number"
            )
        waited = time.monotonic() - started
        if waited > _WAIT_LOG_DELAY and not logged:
            logged = True
            text = f"still waiting for {', '.join(monitor.missing()[:3])}"
            if first_start:
                text = "the first start compiles the code, which takes up to a minute"
            print(f"  {text}", file=sys.stderr, flush=True)
        if waited > _READY_TIMEOUT:
            raise FlightError(
                f"the nodes did not connect within {_READY_TIMEOUT:g} s, missing: "
                f"{', '.join(monitor.missing())}"
            )
        monitor.spin(0.02)


def _check_alive(processes: Iterable[NodeProcess]) -> None:
    for process in processes:
        if process.has_ended:
            raise FlightError(process.unexpected_end())
