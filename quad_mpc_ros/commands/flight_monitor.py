"""Watching a flight from the process that started it: are the nodes ready, how far are they."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from std_srvs.srv import Trigger

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import (
    CLOCK,
    COMMAND,
    DIAGNOSTICS,
    ODOMETRY,
    PREDICTED_PATH,
    REFERENCE,
    REFERENCE_PATH,
    STATS,
)
from quad_mpc_ros.ros.health import PEERS_KEY
from quad_mpc_ros.ros.messages import decoded

# Who must hear whom before the clock starts, by node and topic: the number of peers of the
# node's endpoint. Publishers count subscribers: the odometry's are mpc, reference, recorder and
# this monitor. Subscribers count publishers, of which there must be exactly one.
_PEERS: dict[str, dict[str, int]] = {
    "simulator": {ODOMETRY.name: 4, COMMAND.name: 1},
    "reference": {REFERENCE.name: 3, REFERENCE_PATH.name: 1, ODOMETRY.name: 1},
    "mpc": {
        COMMAND.name: 2,
        STATS.name: 1,
        PREDICTED_PATH.name: 1,
        ODOMETRY.name: 1,
        REFERENCE.name: 1,
    },
    "recorder": {
        f"/{topic.name}": 1
        for topic in (ODOMETRY, REFERENCE, COMMAND, PREDICTED_PATH, REFERENCE_PATH, STATS)
    },
}
_ONLY_ONE = {
    "simulator": (COMMAND.name,),
    "mpc": (ODOMETRY.name, REFERENCE.name),
    "reference": (ODOMETRY.name,),
}
# In lockstep mpc, reference and recorder follow the clock, and the recorder records it.
_CLOCK_PEERS = 4


class FlightMonitor(Observer):
    """A small node of its own, spun from the main thread of ``quad_mpc fly``."""

    def __init__(self, *, lockstep: bool) -> None:
        super().__init__("quad_mpc_flight")
        self._peers = {node: dict(topics) for node, topics in _PEERS.items()}
        if lockstep:
            self._peers["simulator"][CLOCK.name] = _CLOCK_PEERS
            self._peers["recorder"][CLOCK.name] = 1
        self._health: dict[str, dict[str, str]] = {}
        self._odometry: bytes | None = None
        self._reference: bytes | None = None
        self._first_ns: int | None = None

    def __enter__(self) -> Self:
        super().__enter__()
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        # Raw: they are decoded only when somebody looks, not fifty times a second.
        subscribe(self.node, ODOMETRY, self._on_odometry, raw=True)
        subscribe(self.node, REFERENCE, self._on_reference, raw=True)
        self._start = self.node.create_client(Trigger, "simulator/start")
        return self

    def spin(self, seconds: float) -> None:
        """Handle what has arrived, waiting at most so long for the first of it."""
        self.executor.spin_once(timeout_sec=seconds)

    def ready(self) -> bool:
        """Whether every node hears the others and the recorder has everybody's parameters."""
        return not self.missing() and bool(self._start.service_is_ready())

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
        if self._health.get("recorder", {}).get("parameters_missing", "all"):
            missing.append("recorder: parameters")
        return missing

    def intruders(self) -> str:
        """Return a topic that somebody else publishes as well, or nothing."""
        for node, topics in _ONLY_ONE.items():
            for topic in topics:
                count = int(self._health.get(node, {}).get(f"{PEERS_KEY}{topic}", 0))
                if count > 1:
                    return f"{count} publishers on {topic}"
        return ""

    def progress(self) -> tuple[float, float | None]:
        """Return the time flown [s] and the position error [m] of what has last arrived."""
        if self._odometry is None:
            return 0.0, None
        odometry = conversions.odometry_from_message(decoded(ODOMETRY, self._odometry))
        if self._first_ns is None:
            self._first_ns = odometry.stamp_ns
        flown = (odometry.stamp_ns - self._first_ns) * 1e-9
        if self._reference is None:
            return flown, None
        window = conversions.reference_from_message(decoded(REFERENCE, self._reference))
        return flown, float(np.linalg.norm(window.pose_at(odometry.stamp_ns)[0] - odometry.p_WB))

    def start_simulator(self) -> None:
        """Start the clock of the simulator."""
        self.executor.spin_until_future_complete(
            self._start.call_async(Trigger.Request()), timeout_sec=5.0
        )

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self._health[status.name.removeprefix("/")] = values

    def _on_reference(self, data: bytes) -> None:
        self._reference = data

    def _on_odometry(self, data: bytes) -> None:
        self._odometry = data
