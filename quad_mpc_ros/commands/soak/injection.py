"""Doing to messages and processes what a fault says."""

from __future__ import annotations

import signal
import time
from typing import Any, NamedTuple

from quad_mpc_ros.commands.soak.rig import Rig
from quad_mpc_ros.faults.cases import Fault, ProcessFault
from quad_mpc_ros.faults.parameter_changes import Change, good_and_bad_changes
from quad_mpc_ros.mpc_config import MpcConfig

_CHANGE_PERIOD = 0.02  # s
_MOST_UNANSWERED = 5  # changes; a service forgets what comes when ten wait


# After its first odometry a simulator takes a moment to run evenly.
_WARM_UP = 0.5  # s


class Injected(NamedTuple):
    """When it was, by the system's clock in nanoseconds, and what is to be complained of.

    Timeouts count from ``origin_ns``: when the last good message was passed on, or when the fault
    began where it is not one of messages. It may have ended from ``end_ns`` on.
    """

    origin_ns: int
    end_ns: int
    complaints: list[str]


def inject(fault: Fault, rig: Rig, config: MpcConfig) -> Injected:
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


def _distort(fault: Fault, rig: Rig) -> Injected:
    """Let messages, solver or clock fail."""
    for relay, distortion in ((rig.odometry, fault.odometry), (rig.reference, fault.reference)):
        if fault.intruder and distortion is not None:
            relay.intrude()
    rig.wait(lambda: rig.odometry.heard and rig.reference.heard, "the MPC to hear the second one")
    if fault.switch:
        rig.switch(fault.switch, True)
    origin_ns = _begin(fault, rig)
    rig.spin(fault.duration)
    end_ns = time.time_ns()
    if fault.switch:
        rig.switch(fault.switch, False)
    for relay in (rig.odometry, rig.reference):
        relay.end()
    return Injected(origin_ns, end_ns, [])


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


def _pause(fault: Fault, rig: Rig) -> Injected:
    began_ns = time.time_ns()
    rig.processes["mpc"].send(signal.SIGSTOP)
    rig.spin(fault.duration)
    end_ns = time.time_ns()
    rig.processes["mpc"].send(signal.SIGCONT)
    return Injected(began_ns, end_ns, [])


def _restart(rig: Rig) -> Injected:
    rig.stop("simulator")
    origin_ns = rig.odometry.last_heard_ns
    rig.start("simulator", autostart=True)
    rig.wait(lambda: rig.odometry.last_heard_ns > origin_ns, "odometry of another simulator")
    end_ns = rig.odometry.last_heard_ns
    rig.spin(_WARM_UP)
    return Injected(origin_ns, end_ns, [])


def _set_parameters(fault: Fault, rig: Rig, config: MpcConfig) -> Injected:
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
    return Injected(began_ns, time.time_ns(), wrong)


def _unanswered(asked: list[tuple[Change, Any]]) -> int:
    return sum(not answer.done() for _, answer in asked)
