"""Fault after fault over DDS, in one flight that recovers between them."""

from __future__ import annotations

import functools
import itertools
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from quad_mpc_ros.commands.soak.rig import NODES, Rig, SoakError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.experiments.faults.cases import Fault, ProcessFault
from quad_mpc_ros.experiments.faults.parameter_changes import Change, good_and_bad_changes
from quad_mpc_ros.experiments.faults.verdict import Record, Sighting, complaints, course_seen

# Tolerance of a course [s]: the latency of this process and of the MPC's; stalls of this process
# are added.
SLACK = 0.05
_AFTER_HOME = 0.3  # s
_CHANGE_PERIOD = 0.02  # s
_MOST_UNANSWERED = 5  # changes; a service forgets what comes when ten wait
# After its first odometry a simulator takes a moment to run evenly.
_WARM_UP = 0.5  # s
_START_TIMEOUT = 60.0  # s
# For a second the MPC learns the noise of an odometry that is new, and takes every position.
_LEARNS = 1.5  # s
_FLYING_FOR = 0.3  # s


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a fault, without complaints if all is well.

    ``began_ns`` and ``ended_ns`` are by the system's clock.
    """

    fault: Fault
    complaints: list[str]
    seen: str
    began_ns: int
    ended_ns: int


def campaign(faults: tuple[Fault, ...], rig: Rig, config: MpcConfig) -> Iterator[Outcome]:
    """Inject the faults one after the other and yield the outcomes.

    Raises :class:`SoakError` when the flight itself ends.
    """
    for fault in faults:
        if fault.process is ProcessFault.START_NODES:
            yield _started(fault, rig)
    in_flight = [fault for fault in faults if fault.process is not ProcessFault.START_NODES]
    if in_flight:
        rig.fly()
    for fault in in_flight:
        rig.spin(_LEARNS)
        rig.settle()
        yield _flown(fault, rig, config)


def _started(fault: Fault, rig: Rig) -> Outcome:
    began_ns = time.time_ns()
    complaints = _start_in_every_order(rig)
    return Outcome(
        fault=fault,
        complaints=complaints,
        seen="" if complaints else "mpc each time",
        began_ns=began_ns,
        ended_ns=time.time_ns(),
    )


def _flown(fault: Fault, rig: Rig, config: MpcConfig) -> Outcome:
    counted, unsound = _count(fault, rig), len(rig.watch.unsound)
    began_ns, rig.stall = time.time_ns(), 0.0
    origin_ns, end_ns, wrong = _inject(fault, rig, config)
    ended_ns = time.time_ns()
    home_ns = _come_home(fault, rig, config)
    if fault.process is ProcessFault.RESTART_SIMULATOR:
        # Another vehicle, and nobody commanded it at first: how far it fell says nothing of the
        # MPC, but that it has come home does.
        rig.motion.clear()

    def since(when_ns: int) -> float:
        return (when_ns - origin_ns) * 1e-9

    record = Record(
        sightings=[
            Sighting(time=since(tick.sent_ns), source=tick.source, reason=tick.reason)
            for tick in rig.watch.ticks
            if tick.sent_ns >= origin_ns
        ],
        commands=[since(sent_ns) for sent_ns in rig.watch.commands_ns],
        end=since(end_ns),
        over=since(ended_ns),
        home=None if home_ns is None else since(home_ns),
        unsound=[*wrong, *rig.watch.unsound[unsound:]],
        counted=_count(fault, rig) - counted,
        starved=[
            (since(start), since(until)) for start, until in rig.odometry.starved_since(ended_ns)
        ],
    )
    return Outcome(
        fault=fault,
        complaints=complaints(fault, record, config, slack=SLACK + rig.stall),
        seen=course_seen(record),
        began_ns=began_ns,
        ended_ns=ended_ns,
    )


def _come_home(fault: Fault, rig: Rig, config: MpcConfig) -> int | None:
    """Fly until the vehicle is back at its reference and return when that was, if it was."""
    rig.spin(fault.recovery(config))
    deadline = time.monotonic() + SLACK + fault.home
    while not rig.home and time.monotonic() < deadline:
        rig.spin(0.02)
    home_ns = time.time_ns() if rig.home else None
    rig.spin(_AFTER_HOME)
    return home_ns


def _count(fault: Fault, rig: Rig) -> int:
    return int(rig.watch.stats.get(fault.counter, 0))


class _Injected(NamedTuple):
    """When it was, by the system clock [ns], and the complaints.

    Timeouts count from ``origin_ns``: when the last good message was passed on, or when the fault
    began where it is not one of messages. It may have ended from ``end_ns`` on.
    """

    origin_ns: int
    end_ns: int
    complaints: list[str]


def _inject(fault: Fault, rig: Rig, config: MpcConfig) -> _Injected:
    """Let a fault happen from its beginning to its end."""
    match fault.process:
        case ProcessFault.PAUSE_MPC:
            return _pause(fault, rig)
        case ProcessFault.RESTART_SIMULATOR:
            return _restart(rig)
        case ProcessFault.SET_PARAMETERS:
            return _set_parameters(fault, rig, config)
        case _:
            return _distort(fault, rig)


def _distort(fault: Fault, rig: Rig) -> _Injected:
    """Let messages, solver or clock fail."""
    for relay, distortion in ((rig.odometry, fault.odometry), (rig.reference, fault.reference)):
        if fault.intruder and distortion is not None:
            relay.intrude()
    rig.wait(
        lambda: rig.odometry.matched and rig.reference.matched,
        "the MPC to be subscribed to the second publisher",
    )
    if fault.switch:
        rig.switch(fault.switch, True)
    origin_ns = _begin(fault, rig)
    rig.spin(fault.duration)
    end_ns = time.time_ns()
    if fault.switch:
        rig.switch(fault.switch, False)
    for relay in (rig.odometry, rig.reference):
        relay.end()
    return _Injected(origin_ns, end_ns, [])


def _begin(fault: Fault, rig: Rig) -> int:
    """Let relayed messages fail and return the time from which on timeouts count."""
    for relay in (rig.odometry, rig.reference):
        relay.shift(fault.clock)
    if fault.odometry is not None:
        rig.odometry.begin(fault.odometry)
        return rig.odometry.passed[-1].when_ns
    if fault.reference is not None:
        rig.reference.begin(fault.reference)
        return rig.reference.passed[-1].when_ns
    return time.time_ns()


def _pause(fault: Fault, rig: Rig) -> _Injected:
    began_ns = time.time_ns()
    rig.processes["mpc"].send(signal.SIGSTOP)
    rig.spin(fault.duration)
    end_ns = time.time_ns()
    rig.processes["mpc"].send(signal.SIGCONT)
    return _Injected(began_ns, end_ns, [])


def _restart(rig: Rig) -> _Injected:
    rig.stop("simulator")
    origin_ns = rig.odometry.last_received_ns
    rig.start("simulator", autostart=True)
    rig.wait(lambda: rig.odometry.last_received_ns > origin_ns, "odometry of another simulator")
    end_ns = rig.odometry.last_received_ns
    rig.spin(_WARM_UP)
    return _Injected(origin_ns, end_ns, [])


def _set_parameters(fault: Fault, rig: Rig, config: MpcConfig) -> _Injected:
    began_ns = time.time_ns()
    asked: list[tuple[Change, Any]] = []
    changes = good_and_bad_changes(config)
    for _ in range(round(fault.duration / _CHANGE_PERIOD / 2)):
        # In pairs, so that the last good one gives back what was there.
        for change in (next(changes), next(changes)):
            asked.append((change, rig.set_parameters(change)))
            rig.spin(_CHANGE_PERIOD)
            rig.wait(lambda: _unanswered(asked) < _MOST_UNANSWERED, "answers to changes")
    rig.wait(lambda: not _unanswered(asked), "answers to changed parameters")
    wrong = [
        f"{'refused' if change.good else 'accepted'}: {dict(change.values)}"
        for change, answer in asked
        if answer.result().result.successful is not change.good
    ]
    return _Injected(began_ns, time.time_ns(), wrong)


def _unanswered(asked: list[tuple[Change, Any]]) -> int:
    return sum(not answer.done() for _, answer in asked)


def _start_in_every_order(rig: Rig) -> list[str]:
    """Start each node when the one before it is there, and return what went wrong."""
    wrong = []
    for order in itertools.permutations(NODES):
        try:
            _start_in_order(rig, order)
        except SoakError as error:
            wrong.append(f"{', '.join(order)}: {error}")
        for node in order:
            if node in rig.processes:
                rig.stop(node)
    rig.watch.forget()
    return [*wrong, *rig.watch.unsound]


def _start_in_order(rig: Rig, order: tuple[str, ...]) -> None:
    rig.wait(
        lambda: set(NODES).isdisjoint(rig.node.get_node_names()),
        f"no node named {', '.join(NODES)} to be on this ROS domain",
        timeout=_START_TIMEOUT,
    )
    rig.watch.forget()
    for node in order:
        rig.start(node, **({"autostart": True} if node == "simulator" else {}))
        rig.wait(
            functools.partial(_is_there, rig, node), f"{node} to start", timeout=_START_TIMEOUT
        )
    rig.wait(lambda: rig.watch.source_for(_FLYING_FOR) == "mpc", "the MPC to fly")


def _is_there(rig: Rig, node: str) -> bool:
    return node in rig.node.get_node_names()
