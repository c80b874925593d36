"""Did the controller do what a fault calls for?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.experiments.faults import courses
from quad_mpc_ros.experiments.faults.cases import Fault

_HOME = 0.3  # m: nearer to the reference the vehicle is back
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """Who commanded in a tick, and why."""

    time: float
    source: str
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Record:
    """What was seen of a fault, in seconds since the last good message before it.

    ``commands`` are the times of commands. The fault lasted until ``end`` and was ``over`` a
    little later, which is the same where it is known exactly; at ``home`` the vehicle was back at
    its reference, None if never. ``unsound`` are complaints about commands, ``counted`` is how
    much the fault's counter grew, None without one. ``starved`` are times from and until which
    the machine, not the fault, brought no newer odometry.
    """

    sightings: Sequence[Sighting]
    commands: Sequence[float]
    end: float
    over: float
    home: float | None
    unsound: Sequence[str] = ()
    counted: int | None = None
    starved: Sequence[tuple[float, float]] = ()


def is_home(position_error: float) -> bool:
    """Whether the vehicle is at its reference, given its distance [m]."""
    return position_error < _HOME


def command_fault(command: CommandSample, config: MpcConfig) -> str | None:
    """Return why a command must never be sent, or None."""
    values = [command.throttle, *command.w_WB_B.tolist()]
    if not all(math.isfinite(value) for value in values):
        return f"command is not finite: {values}"
    if not config.throttle_min - _ROUNDING <= command.throttle <= config.throttle_max + _ROUNDING:
        return f"throttle {command.throttle:.6f} is out of bounds"
    if (np.abs(command.w_WB_B) > np.array(config.omega_max) + _ROUNDING).any():
        return f"body rates {command.w_WB_B} are out of bounds"
    return None


def complaints(fault: Fault, record: Record, config: MpcConfig, *, slack: float) -> list[str]:
    """Return all that is wrong; ``slack`` [s] is what the measuring of times may be off by."""
    course = fault.course(config)
    # The phases long enough for a tick to fall into them.
    certain = courses.certain(course, record.end, slack=slack, least=2.0 / config.control_rate)
    return [
        *record.unsound[:1],
        *_off_course(course, certain, record, slack),
        *_not_silent(certain, record),
        *_not_recovered(fault, record, config, slack),
        *_not_counted(fault, record),
    ]


def _off_course(
    course: courses.Course, certain: courses.Spans, record: Record, slack: float
) -> list[str]:
    during = [sighting for sighting in record.sightings if 0.0 < sighting.time < record.end]
    wrong = [
        f"{seen.source} at {seen.time:.3f} s, expected {_either(allowed)}"
        for seen in during
        if seen.source not in (allowed := courses.allowed(course, seen.time, slack=slack))
    ]
    missing = [
        f"{_either(phase.sources)} never seen between {start:.3f} s and {until:.3f} s"
        for phase, start, until in certain
        if not any(start <= s.time <= until and s.source in phase.sources for s in during)
    ]
    return [*wrong[:1], *missing]


def _not_silent(certain: courses.Spans, record: Record) -> list[str]:
    """Where the ladder says stop, nothing is sent."""
    for phase, start, until in certain:
        if phase.sources == ("silent",):
            sent = sum(start < time < until for time in record.commands)
            return [f"{sent} commands while silent"] if sent else []
    return []


def _not_recovered(fault: Fault, record: Record, config: MpcConfig, slack: float) -> list[str]:
    due = record.over + fault.recovery(config) + slack
    after = [sighting for sighting in record.sightings if sighting.time >= due]
    if not after:
        return [f"no tick after {due:.3f} s"]
    late = [s for s in after if s.source != "mpc" and not _is_starved(s, record, config)]
    if late:
        return [f"{late[-1].source} still at {late[-1].time:.3f} s: {late[-1].reason}"]
    if record.home is None or record.home > due + fault.home:
        return [f"not back at the reference within {fault.home:g} s"]
    return []


def _is_starved(seen: Sighting, record: Record, config: MpcConfig) -> bool:
    """Whether no odometry came for longer than the ladder waits, when no MPC may command."""
    return seen.source in ("plan", "blind") and any(
        start + config.odom_timeout - _ROUNDING <= seen.time <= until + 1.0 / config.control_rate
        for start, until in record.starved
    )


def _not_counted(fault: Fault, record: Record) -> list[str]:
    if fault.counter and not record.counted:
        return [f"not counted in {fault.counter}"]
    return []


def _either(sources: Sequence[str]) -> str:
    return " or ".join(dict.fromkeys(sources)) or "nothing"


def course_seen(record: Record) -> str:
    """Return in words which sources followed each other during a fault, and the recovery."""
    words, last = [], "mpc"
    for seen in record.sightings:
        if seen.source != last:
            when = seen.time if seen.time < record.end else seen.time - record.end
            sign = "" if seen.time < record.end else "+"
            words.append(f"{seen.source} {sign}{when:.2f}")
            last = seen.source
    return ", ".join(words) or "mpc"
