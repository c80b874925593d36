# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the vehicle parameters that nodes report in their diagnostics."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

from rclpy.node import Node

from quad_mpc_ros.configuration.vehicle import disagreements
from quad_mpc_ros.messages.topics import DIAGNOSTICS
from quad_mpc_ros.ros.messages import message_in
from quad_mpc_ros.ros.preflight.finding import Finding
from quad_mpc_ros.ros.preflight.vehicles import carried_differently

VEHICLE_KEY = "vehicle"
"""Key of the diagnostic value with a node's vehicle as JSON."""
_VEHICLE_MARK = b"vehicle\0"
_REPORT_TIMEOUT = 5.0  # s without a report: the node has ended


class VehicleWatch:
    """Compares a node's vehicle with the vehicles of other nodes in its namespace."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        self._node, self._values = node, values
        self._stated: dict[str, tuple[Mapping[str, Any], float]] = {}
        self._faults: dict[str, str] = {}

    def receive(self, data: bytes) -> None:
        """Process a raw message of ``/diagnostics``; log new differences."""
        if _VEHICLE_MARK not in data:  # other nodes report there, too
            return
        for status in message_in(DIAGNOSTICS, data).status:
            namespace, _, name = status.name.rpartition("/")
            if (namespace or "/") != self._node.get_namespace() or name == self._node.get_name():
                continue
            for entry in status.values:
                if entry.key == VEHICLE_KEY:
                    self._compare(name, entry.value)

    def fault(self) -> str:
        """Return the nodes with another vehicle and the differences, or an empty string."""
        return "; ".join(self._faults[name] for name in self._fresh() if self._faults[name])

    def contradictions(self) -> list[Finding]:
        """Return differences that must be fixed before a flight."""
        return carried_differently({self._node.get_name(): self._values, **self._fresh()})

    def _fresh(self) -> dict[str, Mapping[str, Any]]:
        """Return the vehicles of nodes with recent reports."""
        since = time.monotonic() - _REPORT_TIMEOUT
        return {name: it for name, (it, at) in self._stated.items() if at > since}

    def _compare(self, name: str, text: str) -> None:
        ours = self._node.get_name()
        try:
            stated = json.loads(text)
            differ = disagreements({ours: self._values, name: stated}).values()
        except (ValueError, TypeError, AttributeError):
            return  # of another package
        fault = f"{ours} and {name} have different vehicle parameters: {', '.join(differ)}"
        if differ and fault != self._faults.get(name):
            self._node.get_logger().warning(f"{fault}; give every node the same vehicle file")
        self._stated[name] = stated, time.monotonic()
        self._faults[name] = fault if differ else ""
