# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics: the statistics of a tick of the MPC, and the levels of a status."""

from __future__ import annotations

from typing import Any

from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import cdr

OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"
"""The levels of a ``diagnostic_msgs/DiagnosticStatus``."""

PEERS_KEY = "peers."
"""Prefix of the number of matched peers of a topic, in the health of a node."""

STATS_NAME = "quad_mpc_ros: mpc tick"


def written_stats(stats: TickStats) -> bytes:
    """Return the figures of a tick as the bytes of a ``diagnostic_msgs/DiagnosticArray``."""
    return cdr.written_diagnostics(
        stamp_ns=stats.stamp_ns,
        level={"mpc": OK, "plan": WARN}.get(stats.source, ERROR),
        name=STATS_NAME,
        text=stats.reason or "ok",
        values=stats.items(),
    )


def stats_from_message(message: Any) -> dict[str, str]:
    """Return the figures of an ``mpc/stats`` message as text."""
    return {pair.key: pair.value for status in message.status for pair in status.values}
