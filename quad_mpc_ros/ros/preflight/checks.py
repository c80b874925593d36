"""Every check of a running vehicle before its flight, one function each, in one table.

A check reads the facts and returns what it found: one finding that all is well, or what is to be
mended or looked at, or nothing where there is nothing to judge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from quad_mpc_ros.configuration.vehicle import describes_vehicle
from quad_mpc_ros.messages.topics import COMMAND, ENGAGED, ODOMETRY, REFERENCE
from quad_mpc_ros.ros.preflight.facts import (
    MPC_NODE,
    RECORDER_NODE,
    REFERENCE_NODE,
    SIMULATOR_NODE,
    Facts,
    TopicFacts,
)
from quad_mpc_ros.ros.preflight.finding import Finding, error, ok, unknown, warning
from quad_mpc_ros.ros.preflight.odometry import (
    clock_findings,
    frame_findings,
    motion_findings,
    rate_findings,
)
from quad_mpc_ros.ros.preflight.own import (
    FREE_KEY,
    LANDED_KEY,
    REFUSED_KEY,
    STACK_FAULT_KEY,
    disk_findings,
    lag_findings,
    throttle_findings,
)
from quad_mpc_ros.ros.preflight.thrust_map import thrust_map_findings
from quad_mpc_ros.ros.preflight.vehicles import vehicle_findings
from quad_mpc_ros.ros.preflight.way import fence_findings, limits_findings, rates_findings

_ANY, _NONE = "", "none"
# Of a LiPo cell [V] and of the charge: below the first look at it, below the second do not fly.
_LOW_CELL, _EMPTY_CELL = 3.6, 3.4
_LOW_SHARE, _EMPTY_SHARE = 0.4, 0.2
# Of the voltage of the thrust map: beyond this the bridge's correction grows large.
_VOLTAGE_OFF = 0.15


def findings(facts: Facts) -> list[tuple[str, Finding]]:
    """Return what every check finds, by its name, in the order of the table."""
    return [(name, found) for name, check in CHECKS.items() for found in check(facts)]


def nodes(facts: Facts) -> list[Finding]:
    """Are the nodes there, once each, and active?"""
    found = [
        error(f"{node.count} nodes are called {name}", "end all but one, or give each a namespace")
        for name, node in facts.nodes.items()
        if node.count > 1
    ]
    found += [
        error(
            f"{name}: {node.fault}",
            "look at its log: it may still be compiling, or be of another release",
        )
        for name, node in facts.nodes.items()
        if node.fault
    ]
    found += [*_missing(facts), *_inactive(facts)]
    source = facts.nodes[MPC_NODE].values.get("source", "mpc") if MPC_NODE in facts.nodes else ""
    if source not in ("", "mpc"):
        found.append(
            warning(
                f"the mpc does not plan but {source}: {facts.nodes[MPC_NODE].health}",
                "docs/diagnostics.md says what to do about it",
            )
        )
    if found:
        return found
    return [ok(", ".join(f"{name} {node.state}".strip() for name, node in facts.nodes.items()))]


def _missing(facts: Facts) -> list[Finding]:
    found = []
    if MPC_NODE not in facts.nodes:
        found.append(
            error(
                "no mpc node in this namespace",
                "start it; compare --namespace, ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE",
            )
        )
    reference = facts.topics.get(REFERENCE.name)
    if REFERENCE_NODE not in facts.nodes and (reference is None or not reference.publishers):
        found.append(error("no reference node", "start it, or publish reference yourself"))
    bridges = facts.bridges
    if facts.bridge not in (_ANY, _NONE) and facts.bridge not in bridges:
        there = f", there is {', '.join(bridges)}" if bridges else ""
        found.append(error(f"{facts.bridge} does not run{there}", "start it, or name another"))
    if facts.bridge == _NONE and bridges:
        found.append(
            error(f"{', '.join(bridges)} runs, expected no bridge", "end it, or leave --bridge")
        )
    if facts.bridge == _ANY and not bridges and SIMULATOR_NODE not in facts.nodes:
        found.append(
            warning(
                "neither a bridge nor a simulator runs",
                "start one, or --bridge none if your own autopilot takes the commands",
            )
        )
    return found


def _inactive(facts: Facts) -> list[Finding]:
    return [
        error(
            f"{name} is not active: {node.health or 'it has not reported its health'}",
            "mend that; docs/lifecycle.md says how to activate it by hand",
        )
        for name, node in facts.nodes.items()
        if name in (MPC_NODE, REFERENCE_NODE) and node.state != "active"
    ]


def vehicles(facts: Facts) -> list[Finding]:
    """Were the nodes given the same vehicle?"""
    given = {
        name: node.config.vehicle_values()
        for name, node in facts.nodes.items()
        if node.config is not None and node.config.vehicle_values()
    }
    if not given:
        return [unknown("the parameters of no node are known")]
    return vehicle_findings(given) or [ok(f"{', '.join(given)} have the same")]


def file(facts: Facts) -> list[Finding]:
    """Do the nodes have what the files of the command line state?"""
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
        for parameter in stated:
            if held[parameter] == wanted[parameter]:
                continue
            judged = error if describes_vehicle(parameter) else warning
            found.append(
                judged(
                    f"{name} has {parameter} {_shown(held[parameter])}, the file "
                    f"{_shown(wanted[parameter])}",
                    f"start {name} with the file",
                )
            )
    if not compared:
        return [unknown("no node runs whose parameters could be compared with the file")]
    return found or [ok(f"{', '.join(compared)} as the file states")]


def throttle(facts: Facts) -> list[Finding]:
    """Does the throttle in hover leave room to both sides, for the MPC and the stack?"""
    mpc = facts.mpc
    if mpc is None:
        return [_NO_MPC]
    found = throttle_findings(mpc)
    for config in facts.bridge_configs.values():
        found += thrust_map_findings(config)
    hover = mpc.vehicle().hover_throttle
    lift = mpc.thrust(mpc.throttle_max) / (mpc.mass * mpc.gravity)
    return found or [ok(f"hovers at {hover:.3f}, lifts {lift:.1f} times the weight")]


def topics(facts: Facts) -> list[Finding]:
    """Has each topic one publisher that its subscriptions understand?"""
    if not facts.topics:
        return [unknown("no topic is known")]
    found: list[Finding] = []
    for role in (ODOMETRY.name, REFERENCE.name, COMMAND.name, ENGAGED.name):
        topic = facts.topics.get(role)
        if topic is not None:
            found += _topic(topic, optional=role == ENGAGED.name and not facts.bridges)
    found += _unheard(facts)
    checked = ", ".join(topic.name for topic in facts.topics.values() if topic.publishers)
    return found or [ok(f"one publisher each: {checked}")]


def _topic(topic: TopicFacts, *, optional: bool) -> list[Finding]:
    found = []
    who = ", ".join(end.node for end in topic.publishers)
    if len(topic.publishers) > 1:
        found.append(
            error(
                f"{len(topic.publishers)} publishers on {topic.name}, expected one: {who}",
                "end the others",
            )
        )
    if not topic.publishers and not optional:
        found.append(error(f"no publisher on {topic.name}", "start it, or remap its topic"))
    for end in (*topic.publishers, *topic.subscriptions):
        if end.type_name != topic.type_name:
            found.append(
                error(
                    f"{topic.name} of {end.node} has the type {end.type_name}, expected "
                    f"{topic.type_name}",
                    "remap one of them",
                )
            )
    remedy = "set the quality of service of one of them"
    return found + [error(f"{topic.name}: {each}", remedy) for each in topic.mismatches]


def _unheard(facts: Facts) -> list[Finding]:
    """Return whether those who act on commands do not listen where the MPC publishes them."""
    command = facts.topics.get(COMMAND.name)
    if command is None or not command.publishers:
        return []
    hearing = {end.node.rpartition("/")[2] for end in command.subscriptions}
    # Behind a bridge a simulator is the stack's, and hears the stack.
    acting = list(facts.bridges) or [name for name in facts.nodes if name == SIMULATOR_NODE]
    return [
        error(f"{name} does not listen to {command.name}", "remap its topic, or the MPC's")
        for name in acting
        if name not in hearing
    ]


def stack(facts: Facts) -> list[Finding]:
    """Does the flight stack report, and does the vehicle stand on the ground?"""
    reported = {name: node for name, node in facts.bridges.items() if node.values}
    if not reported:
        return [unknown(f"{name} has not reported its health") for name in facts.bridges]
    found = []
    for name, node in reported.items():
        fault = node.values.get(STACK_FAULT_KEY, "")
        if fault:
            found.append(error(f"{name}: {fault}", "see the page of the stack in docs/stacks"))
        elif node.values.get(LANDED_KEY) == "false":
            found.append(
                warning(
                    f"{name} reports that the vehicle is flying",
                    "land it: several checks need a vehicle at rest on the ground",
                )
            )
    return found or [ok(f"{', '.join(reported)}: the stack reports its state")]


def battery(facts: Facts) -> list[Finding]:
    """Is the battery charged, and near the voltage of the thrust map?"""
    state = facts.battery
    if state is None:
        return []
    measured = [
        ("the charge", state.share, _LOW_SHARE, _EMPTY_SHARE, ""),
        ("the weakest cell", state.cell, _LOW_CELL, _EMPTY_CELL, " V"),
    ]
    found = []
    for name, value, low, empty, unit in measured:
        if value is not None and value < low:
            judged = error if value < empty else warning
            found.append(
                judged(f"{name} is {value:.3g}{unit}, expected {low:g}{unit} or more", "charge it")
            )
    for name, config in facts.bridge_configs.items():
        at = config.thrust_map.battery_voltage
        if at and state.voltage is not None and abs(state.voltage / at - 1.0) > _VOLTAGE_OFF:
            found.append(
                warning(
                    f"{state.voltage:.1f} V, the thrust map of {name} is for {at:.1f} V",
                    "charge it, or check thrust_map.battery_voltage and the number of cells",
                )
            )
    told = [f"{state.voltage:.2f} V"] if state.voltage is not None else []
    told += [f"{name} {v:.3g}{unit}" for name, v, _, _, unit in measured if v is not None]
    return found or [ok(", ".join(told) or "published, without a voltage")]


def recorder(facts: Facts) -> list[Finding]:
    """Is the flight recorded?"""
    node = facts.nodes.get(RECORDER_NODE)
    if node is None:
        return [
            warning("no recorder runs", "ros2 run quad_mpc_ros recorder_node, to learn from it")
        ]
    if node.state not in ("", "active"):
        return [warning(f"the recorder is {node.health or node.state}", "activate it")]
    return [ok(node.health or "recording")]


def disk(facts: Facts) -> list[Finding]:
    """Is there space for the bag?"""
    node = facts.nodes.get(RECORDER_NODE)
    free = dict(facts.free)
    if node is not None and node.values.get(FREE_KEY, "").isdigit():
        free = {"told by the recorder": int(node.values[FREE_KEY])}
    found = [each for place, count in free.items() for each in disk_findings(place, count)]
    return found or [ok(f"{count / 1e9:.0f} GB free") for count in list(free.values())[:1]]


def lags(facts: Facts) -> list[Finding]:
    """Does the model know that the vehicle lags?"""
    if facts.mpc is None or not facts.bridges:
        return []
    return lag_findings(facts.mpc) or [ok("modelled")]


def code(facts: Facts) -> list[Finding]:
    """Is the machine code compiled, so that a node that is restarted flies at once?"""
    if facts.compiled is None:
        return []
    if facts.compiled:
        return [ok("compiled")]
    return [warning("no compiled machine code on this computer", "run quad_mpc compile, on each")]


def realtime(facts: Facts) -> list[Finding]:
    """Was the MPC granted what it asked of the operating system?"""
    node = facts.nodes.get(MPC_NODE)
    if node is None or REFUSED_KEY not in node.values:
        return []
    refused = node.values[REFUSED_KEY]
    if refused:
        return [warning(refused, "or set it back to its default")]
    return [ok("all that mpc asked for was granted")]


Check = Callable[[Facts], Sequence[Finding]]

CHECKS: dict[str, Check] = {
    "nodes": nodes,
    "vehicles": vehicles,
    "file": file,
    "throttle": throttle,
    "lags": lags,
    "limits": limits_findings,
    "rates": rates_findings,
    "fence": fence_findings,
    "topics": topics,
    "frames": frame_findings,
    "rate": rate_findings,
    "clock": clock_findings,
    "motion": motion_findings,
    "stack": stack,
    "battery": battery,
    "recorder": recorder,
    "disk": disk,
    "code": code,
    "realtime": realtime,
}
"""Every check by the name of its lines; docs/preflight.md says what each means."""

_NO_MPC = unknown("the parameters of mpc are unknown")


def _shown(value: object) -> str:
    return str(list(value)) if isinstance(value, tuple) else str(value)
