"""What the MPC's process publishes, and its memory, seen from outside."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node

from quad_mpc_ros.commands.observer import subscribe
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.experiments.faults.verdict import command_fault
from quad_mpc_ros.messages import cdr, conversions, diagnostics
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, STATS


@dataclass(frozen=True, kw_only=True, slots=True)
class TickSeen:
    """A tick: when its process published it (system's clock), and its figures."""

    sent_ns: int
    stamp_ns: int
    source: str
    reason: str


@dataclass
class Watch:
    """Listens to ``odom``, ``command`` and ``mpc/stats`` and keeps what is judged later.

    Times are those at which the others published, so that a slow listener changes nothing.
    """

    node: Node
    config: MpcConfig
    ticks: list[TickSeen] = field(default_factory=list)
    odometries_ns: dict[int, int] = field(default_factory=dict)
    """When the odometry of a stamp was sent."""
    commands_ns: list[int] = field(default_factory=list)
    unsound: list[str] = field(default_factory=list)
    stats: dict[str, str] = field(default_factory=dict)
    """The figures of the last tick."""

    def __post_init__(self) -> None:
        subscribe(self.node, COMMAND, self._on_command)
        subscribe(self.node, STATS, self._on_stats)
        subscribe(self.node, ODOMETRY, self._on_odometry, raw=True)

    @property
    def connected(self) -> bool:
        """Whether the MPC publishes."""
        names = (COMMAND.name, STATS.name)
        return all(self.node.count_publishers(name) for name in names)

    def forget(self) -> None:
        """Forget the ticks and commands of nodes that have ended."""
        self.ticks.clear()
        self.odometries_ns.clear()
        self.commands_ns.clear()
        self.stats.clear()

    def lateness_ms(self) -> np.ndarray:
        """Return how long after its odometry was sent each tick was published [ms].

        A tick without an odometry has the stamp of its own time.
        """
        sent = self.odometries_ns
        return np.array(
            [1e-6 * (tick.sent_ns - sent.get(tick.stamp_ns, tick.stamp_ns)) for tick in self.ticks]
        )

    def unanswered_ns(self) -> list[int]:
        """Return when the odometries without a tick were sent."""
        answered = {tick.stamp_ns for tick in self.ticks}
        # The first and the last may belong to ticks before and after.
        sent = list(self.odometries_ns.items())[1:-1]
        return [sent_ns for stamp_ns, sent_ns in sent if stamp_ns not in answered]

    def source_for(self, seconds: float) -> str:
        """Return the source that has commanded for this time without interruption, or nothing."""
        if not self.ticks:
            return ""
        last = self.ticks[-1]
        for tick in reversed(self.ticks):
            if tick.source != last.source:
                return ""
            if last.sent_ns - tick.sent_ns >= seconds * 1e9:
                return last.source
        return ""

    def _on_odometry(self, data: bytes, info: dict[str, int]) -> None:
        self.odometries_ns[cdr.header_stamp_ns(data)] = info["source_timestamp"]

    def _on_command(self, message: Any, info: dict[str, int]) -> None:
        self.commands_ns.append(info["source_timestamp"])
        fault = command_fault(conversions.command_from_message(message), self.config)
        if fault is not None:
            self.unsound.append(fault)

    def _on_stats(self, message: Any, info: dict[str, int]) -> None:
        self.stats = diagnostics.stats_from_message(message)
        self.ticks.append(
            TickSeen(
                sent_ns=info["source_timestamp"],
                stamp_ns=int(self.stats["stamp_ns"]),
                source=self.stats["source"],
                reason=self.stats["reason"],
            )
        )


def resident_memory(pid: int) -> int | None:
    """Return the memory of a process that is in use [bytes], or None when it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except OSError:
        return None
    for line in status.splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024
    return None
