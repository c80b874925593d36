# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The table of all preflight checks, one function each.

A check reads the facts and returns findings: one ok, or errors and warnings, or none if the check
does not apply.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from quad_mpc_ros.configuration.vehicle import describes_vehicle
from quad_mpc_ros.control.ocp.margins import stability_margins
from quad_mpc_ros.messages.diagnostics import ERROR, OK
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, REFERENCE
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.thrust import thrust_map_findings
from quad_mpc_ros.ros.preflight.facts import (
    MPC_NODE,
    REFERENCE_NODE,
    SIMULATOR_NODE,
    Facts,
    NodeFacts,
)
from quad_mpc_ros.ros.preflight.finding import Finding, error, ok, unknown, warning
from quad_mpc_ros.ros.preflight.odometry import (
    clock_findings,
    motion_findings,
    rate_findings,
)
from quad_mpc_ros.ros.preflight.own import (
    LANDED_KEY,
    STACK_FAULT_KEY,
    lag_findings,
    margin_findings,
    throttle_findings,
)
from quad_mpc_ros.ros.preflight.reference import fence_findings, limits_findings
from quad_mpc_ros.ros.preflight.vehicles import vehicle_findings

_ANY_BRIDGE, _NO_BRIDGE = "", "none"


def findings(facts: Facts) -> list[tuple[str, Finding]]:
    """Return the findings of all checks with their names, in the order of the table."""
    return [(name, found) for name, check in CHECKS.items() for found in check(facts)]


def nodes(facts: Facts) -> list[Finding]:
    """Check that the nodes run, once each, and are active."""
    found = list(_missing(facts))
    for name, node in facts.nodes.items():
        found += _faults(name, node)
    if found:
        return found
    return [ok(", ".join(f"{name} {node.state}".strip() for name, node in facts.nodes.items()))]


def _faults(name: str, node: NodeFacts) -> Iterator[Finding]:
    """Yield the problems of a running node."""
    if node.count > 1:
        yield error(f"{node.count} nodes are called {name}", "stop all but one, or use namespaces")
    if node.fault:
        yield error(
            f"{name}: {node.fault}",
            "read the log of the node: it might be compiling, or run another release",
        )
    if name in (MPC_NODE, REFERENCE_NODE) and node.state != "active":
        yield error(
            f"{name} is not active: {node.health or 'it has not reported its health'}",
            "fix the reason; docs/reference/lifecycle.md explains manual activation",
        )
    elif name in (MPC_NODE, REFERENCE_NODE, SIMULATOR_NODE) and node.level > OK:
        judged = error if node.level >= ERROR else warning
        yield judged(
            f"{name}: {node.health}", "look up the message in docs/reference/diagnostics.md"
        )


def _missing(facts: Facts) -> Iterator[Finding]:
    if MPC_NODE not in facts.nodes:
        yield error(
            "no mpc node in this namespace",
            "start it; compare --namespace, ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE",
        )
    if REFERENCE_NODE not in facts.nodes and not facts.peers(MPC_NODE, REFERENCE.name):
        yield error("no reference node", "start it, or publish reference yourself")
    bridges = facts.bridges
    if facts.bridge not in (_ANY_BRIDGE, _NO_BRIDGE) and facts.bridge not in bridges:
        there = f", there is {', '.join(bridges)}" if bridges else ""
        yield error(f"{facts.bridge} does not run{there}", "start it, or change --bridge")
    if facts.bridge == _NO_BRIDGE and bridges:
        yield error(f"{', '.join(bridges)} runs, expected no bridge", "stop it, or omit --bridge")
    if facts.bridge == _ANY_BRIDGE and not bridges and SIMULATOR_NODE not in facts.nodes:
        yield warning(
            "neither a bridge nor a simulator runs",
            "start one, or use --bridge none if your autopilot subscribes to the commands",
        )


def vehicles(facts: Facts) -> list[Finding]:
    """Check that the nodes have the same vehicle."""
    given = {
        name: node.config.vehicle_values()
        for name, node in facts.nodes.items()
        if node.config is not None and node.config.vehicle_values()
    }
    if not given:
        return [unknown("the parameters of no node are known")]
    return vehicle_findings(given) or [ok(f"{', '.join(given)} have the same vehicle")]


def file(facts: Facts) -> list[Finding]:
    """Check that the nodes have the parameters of the files on the command line."""
    if not facts.stated:
        return []
    found, compared = [], []
    for name, stated in facts.stated.items():
        node = facts.nodes.get(name)
        if node is None or node.config is None:
            continue
        compared.append(name)
        held = node.config.flattened()
        wanted = type(node.config).build({**held, **stated}).flattened()
        found += [
            (error if describes_vehicle(parameter) else warning)(
                f"{name} has {parameter} {_shown(held[parameter])}, the file "
                f"{_shown(wanted[parameter])}",
                f"start {name} with the file",
            )
            for parameter in stated
            if held[parameter] != wanted[parameter]
        ]
    if not compared:
        return [unknown("no running node has parameters of the file")]
    return found or [ok(f"{', '.join(compared)} match the file")]


def throttle(facts: Facts) -> list[Finding]:
    """Check that the hover throttle leaves a margin for the MPC and the stack."""
    mpc = facts.mpc
    if mpc is None:
        return [_NO_MPC]
    found = list(throttle_findings(mpc))
    for node in facts.bridges.values():
        if isinstance(node.config, BridgeConfig):
            found += thrust_map_findings(node.config)
    hover = mpc.vehicle().hover_throttle
    lift = mpc.thrust(mpc.throttle_max) / (mpc.mass * mpc.gravity)
    return found or [ok(f"hovers at {hover:.3f}, lifts {lift:.1f} times the weight")]


def topics(facts: Facts) -> list[Finding]:
    """Check that the nodes report matched peers on the topics of the flight."""
    wanted = {MPC_NODE: (ODOMETRY, REFERENCE, COMMAND), REFERENCE_NODE: (ODOMETRY,)}
    wanted |= dict.fromkeys((*facts.bridges, SIMULATOR_NODE), (COMMAND,))
    peers = {
        (name, topic.name): count
        for name, topics in wanted.items()
        for topic in topics
        if (count := facts.peers(name, topic.name)) is not None
    }
    if not peers:
        return [unknown("no node has reported its peers")]
    found = [
        error(f"{name} has no peer on {topic}", "start the peer, or remap the topic")
        for (name, topic), count in peers.items()
        if count == 0
    ]
    found += [
        error(f"{count} publishers on {topic} of {name}, expected one", "stop the others")
        for (name, topic), count in peers.items()
        if count > 1 and (name, topic) != (MPC_NODE, COMMAND.name)
    ]
    return found or [ok(f"{', '.join(sorted({topic for _, topic in peers}))} connected")]


def stack(facts: Facts) -> list[Finding]:
    """Check that the flight stack reports its state and the vehicle is on the ground."""
    reported = {name: node for name, node in facts.bridges.items() if node.values}
    if not reported:
        return [unknown(f"{name} has not reported its health") for name in facts.bridges]
    found = []
    for name, node in reported.items():
        if fault := node.values.get(STACK_FAULT_KEY, ""):
            found.append(error(f"{name}: {fault}", "see the stack's page in docs/howto/stacks"))
        elif node.values.get(LANDED_KEY) == "false":
            remedy = "land the vehicle: several checks need a vehicle at rest on the ground"
            found.append(warning(f"{name} reports that the vehicle is flying", remedy))
    return found or [ok(f"{', '.join(reported)}: the stack reports its state")]


def lags(facts: Facts) -> list[Finding]:
    """Check that the lags of the vehicle are modelled, and that more delay is tolerated."""
    mpc = facts.mpc
    if mpc is None or not facts.bridges:
        return []
    delay = stability_margins(mpc).delay
    text = f"modelled; the weights tolerate {1e3 * delay:.0f} ms more delay"
    return [*lag_findings(mpc), *margin_findings(mpc)] or [ok(text)]


Check = Callable[[Facts], Sequence[Finding]]

CHECKS: dict[str, Check] = {
    "nodes": nodes,
    "vehicles": vehicles,
    "file": file,
    "throttle": throttle,
    "lags": lags,
    "limits": limits_findings,
    "fence": fence_findings,
    "topics": topics,
    "rate": rate_findings,
    "clock": clock_findings,
    "motion": motion_findings,
    "stack": stack,
}
"""The checks by name; docs/howto/preflight.md explains them."""

_NO_MPC = unknown("the parameters of mpc are unknown")


def _shown(value: object) -> str:
    return str(list(value)) if isinstance(value, tuple) else str(value)
