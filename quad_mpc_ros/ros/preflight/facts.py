# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The facts about a running vehicle that the preflight checks read."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from quad_mpc_ros.configuration import Configuration
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages.diagnostics import OK, PEERS_KEY
from quad_mpc_ros.references.config import ReferenceConfig

C = TypeVar("C", bound=Configuration)

MPC_NODE, REFERENCE_NODE = "mpc", "reference"
SIMULATOR_NODE = "simulator"
BRIDGE_SUFFIX = "_bridge"
"""Suffix of the name of a bridge's node."""


@dataclass(frozen=True, kw_only=True)
class NodeFacts:
    """A node of the vehicle.

    ``config`` is None if its parameters are missing or invalid; ``fault`` has the reason.
    ``state`` is the lifecycle state, or empty. ``level``, ``health`` and ``values`` are from the
    newest diagnostics. ``count`` is the number of nodes with this name.
    """

    config: Configuration | None = None
    fault: str = ""
    state: str = ""
    level: bytes = OK
    health: str = ""
    values: Mapping[str, str] = dataclasses.field(default_factory=dict)
    use_sim_time: bool = False
    count: int = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrival:
    """An odometry and its time of arrival, by the clock of the nodes [ns]."""

    odometry: OdometrySample
    at_ns: int


ReferenceSamples = tuple[OdometrySample, ...]
"""Samples along the reference, as odometry."""


@dataclass(frozen=True, kw_only=True)
class Facts:
    """The collected facts.

    Attributes:
        nodes: Nodes by name in the namespace.
        bridge: The requested bridge: the name of its node, ``none``, or empty for any.
        has_clock: Whether a node publishes ``/clock``.
        arrivals: Odometries in order.
        reference_samples: Samples along the reference. None if they cannot be computed from the
            parameters; then ``reference_samples_error`` has the reason.
        stated: Values in the files on the command line, by node and parameter.
    """

    nodes: Mapping[str, NodeFacts] = dataclasses.field(default_factory=dict)
    bridge: str = ""
    has_clock: bool = False
    arrivals: tuple[Arrival, ...] = ()
    reference_samples: ReferenceSamples | None = None
    reference_samples_error: str = ""
    stated: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)

    @property
    def mpc(self) -> MpcConfig | None:
        """The parameters of the MPC, None if unknown."""
        return self._config(MPC_NODE, MpcConfig)

    @property
    def reference(self) -> ReferenceConfig | None:
        """The parameters of the reference, None if unknown."""
        return self._config(REFERENCE_NODE, ReferenceConfig)

    @property
    def bridges(self) -> dict[str, NodeFacts]:
        """The running bridges."""
        return {name: node for name, node in self.nodes.items() if name.endswith(BRIDGE_SUFFIX)}

    def peers(self, name: str, topic: str) -> int | None:
        """Return the number of peers that a node reports on a topic; None without report."""
        node = self.nodes.get(name)
        count = None if node is None else node.values.get(f"{PEERS_KEY}{topic}")
        return None if count is None else int(count)

    def _config(self, name: str, kind: type[C]) -> C | None:
        node = self.nodes.get(name)
        return node.config if node is not None and isinstance(node.config, kind) else None

    def changed(self, **fields: Any) -> Facts:
        """Return a copy of the facts with changes."""
        return dataclasses.replace(self, **fields)
