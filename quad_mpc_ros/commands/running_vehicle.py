# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Observation of the running nodes of a vehicle, for the checks before a flight."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from typing import Any, Self

from rclpy.parameter import Parameter

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import Configuration, UserError, files
from quad_mpc_ros.messages.diagnostics import OK
from quad_mpc_ros.messages.topics import CLOCK, DIAGNOSTICS, ODOMETRY, Topic
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.registry import bridge_configurations
from quad_mpc_ros.ros.clocks import SteadyTime
from quad_mpc_ros.ros.messages import odometry_in
from quad_mpc_ros.ros.preflight.facts import (
    BRIDGE_SUFFIX,
    MPC_NODE,
    REFERENCE_NODE,
    Arrival,
    Facts,
    NodeFacts,
    ReferenceSamples,
)
from quad_mpc_ros.ros.preflight.reference import sample_reference

_NODE_NAME = "quad_mpc_preflight"
_DISCOVERY_TIME = 1.5  # s, until nodes are discovered and have reported their health
_ODOMETRY_TIME = 1.5  # s: of odometry
_USE_SIM_TIME = "use_sim_time"


class RunningVehicle(Observer):
    """A node that observes the vehicle in ``namespace``, which has no outer slashes."""

    def __init__(self, namespace: str) -> None:
        super().__init__(_NODE_NAME)
        self._space = f"/{namespace}" if namespace else ""
        self._health: dict[str, Any] = {}
        self._arrivals: list[Arrival] = []

    def __enter__(self) -> Self:
        super().__enter__()
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        return self

    def facts(self, *, bridge: str, timeout: float) -> Facts:
        """Observe the vehicle for some seconds, at most ``timeout``, and return the facts.

        ``bridge`` is as in :class:`Facts`.
        """
        begun = time.monotonic()
        deadline = begun + timeout
        # A vehicle may have another source of its reference, so this does not wait all the time.
        expected = {MPC_NODE, REFERENCE_NODE}
        self.spin_until(lambda: expected <= set(self._names()), begun + 0.5 * timeout)
        names = self._settled_names(deadline)
        awaited = {f"{self._space}/{name}" for name in names}
        answers = self.parameters(awaited, deadline)
        parameters = {full.rpartition("/")[2]: values for full, values in answers.items()}
        if parameters.get(MPC_NODE, {}).get(_USE_SIM_TIME):  # arrivals by the clock of the MPC
            self.node.set_parameters([Parameter(_USE_SIM_TIME, value=True)])
        self._watch(self._odometry_topic(), deadline)
        self.spin_until(lambda: awaited <= self._health.keys(), deadline)
        nodes = {
            name: self._node(name, parameters.get(name), count=names.count(name))
            for name in (*filter(names.__contains__, SCHEMA), *sorted({*names} - SCHEMA.keys()))
        }
        reference_samples, reference_samples_error = _reference_samples(nodes.get(REFERENCE_NODE))
        return Facts(
            nodes=nodes,
            bridge=bridge,
            has_clock=self.node.count_publishers(CLOCK.name) > 0,
            arrivals=tuple(self._arrivals),
            reference_samples=reference_samples,
            reference_samples_error=reference_samples_error,
        )

    def _settled_names(self, deadline: float) -> list[str]:
        """Return the nodes of the vehicle once no more nodes appear."""
        names, since = self._names(), time.monotonic()

        def settled() -> bool:
            nonlocal names, since
            if (now := self._names()) != names:
                names, since = now, time.monotonic()
            return time.monotonic() - since > _DISCOVERY_TIME

        self.spin_until(settled, deadline)
        return names

    def _names(self) -> list[str]:
        """Return the nodes of the vehicle, with duplicates.

        A node's health may be reported before its name is in the graph.
        """
        there = [
            f"{space.rstrip('/')}/{name}"
            for name, space in self.node.get_node_names_and_namespaces()
        ]
        there += sorted(self._health.keys() - set(there))
        return [
            name
            for space, _, name in (each.rpartition("/") for each in there)
            if space == self._space and (name in SCHEMA or name.endswith(BRIDGE_SUFFIX))
        ]

    def _watch(self, odometries: Topic, deadline: float) -> None:
        """Receive odometry for a while."""
        clock = SteadyTime(self.node.get_clock())

        def on_odometry(data: bytes) -> None:
            at_ns = clock.now_ns()
            try:
                odometry = odometry_in(data)
            except ValueError:
                return
            self._arrivals.append(Arrival(odometry=odometry, at_ns=at_ns))

        subscribe(self.node, odometries, on_odometry, raw=True)
        self.spin_until(lambda: bool(self._arrivals), deadline)
        self.spin_until(lambda: False, min(time.monotonic() + _ODOMETRY_TIME, deadline))

    def _node(self, name: str, parameters: dict[str, Any] | None, *, count: int) -> NodeFacts:
        status = self._health.get(f"{self._space}/{name}")
        values = {pair.key: pair.value for pair in status.values} if status is not None else {}
        config, fault = None, "its parameter services do not answer"
        if parameters is not None:
            config, fault = _configuration(name, parameters)
        return NodeFacts(
            config=config,
            fault=fault,
            state=values.get("state", ""),
            level=status.level if status is not None else OK,
            health=status.message if status is not None else "",
            values=values,
            use_sim_time=bool((parameters or {}).get(_USE_SIM_TIME)),
            count=count,
        )

    def _odometry_topic(self) -> Topic:
        """Return the odometry topic, with the name to which the MPC remapped it."""
        used: list[str] = []
        if MPC_NODE in self._names():
            used = [
                name
                for name, types in self.node.get_subscriber_names_and_types_by_node(
                    MPC_NODE, self._space or "/"
                )
                if ODOMETRY.type_name in types
            ]
        name = used[0] if len(used) == 1 else f"{self._space}/{ODOMETRY.name}"
        return dataclasses.replace(ODOMETRY, name=name)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self._health[status.name] = status


def node_configurations() -> dict[str, type[Configuration]]:
    """Return the parameters of every possible node of a vehicle, by node name."""
    return {**SCHEMA, **bridge_configurations()}


def _configuration(name: str, parameters: Mapping[str, Any]) -> tuple[Configuration | None, str]:
    """Return the configuration of a node, or an error."""
    kind = node_configurations().get(name, BridgeConfig)
    # Nodes also have parameters of ROS, and bridges of other packages have their own.
    known = {spec.name for spec in kind.specs()} if kind is BridgeConfig else parameters.keys()
    given = {
        parameter: value
        for parameter, value in parameters.items()
        if parameter in known and not files.is_of_ros(parameter)
    }
    try:
        return kind.build(given), ""
    except UserError as error:
        return None, str(error)


def _reference_samples(node: NodeFacts | None) -> tuple[ReferenceSamples | None, str]:
    if node is None or not isinstance(node.config, ReferenceConfig):
        return None, ""
    try:
        return sample_reference(node.config), ""
    except UserError as error:
        return None, str(error)
