"""Fault after fault over DDS, in one flight that recovers between them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from quad_mpc_ros.commands.soak.injection import inject
from quad_mpc_ros.commands.soak.rig import Rig
from quad_mpc_ros.commands.soak.start_orders import start_in_every_order
from quad_mpc_ros.faults.cases import Fault, ProcessFault
from quad_mpc_ros.faults.verdict import Record, Sighting, complaints, course_seen
from quad_mpc_ros.mpc_config import MpcConfig

# What a course may be off by [s]: how late this process acts, and how late that of the MPC wakes;
# and besides for as long as this one was seen to be kept waiting.
SLACK = 0.05
_AFTER_HOME = 0.3  # s


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a fault: nothing to complain of, if all is well.

    ``began_ns`` and ``ended_ns`` are by the system's clock.
    """

    fault: Fault
    complaints: list[str]
    seen: str
    began_ns: int
    ended_ns: int


def campaign(faults: tuple[Fault, ...], rig: Rig, config: MpcConfig) -> Iterator[Outcome]:
    """Inject the faults one after the other and yield what becomes of each.

    Raises :class:`SoakError` when the flight itself comes to an end.
    """
    for fault in faults:
        if fault.process is ProcessFault.START_NODES:
            yield _started(fault, rig)
    in_flight = [fault for fault in faults if fault.process is not ProcessFault.START_NODES]
    if in_flight:
        rig.fly()
    for fault in in_flight:
        rig.settle()
        yield _flown(fault, rig, config)


def _started(fault: Fault, rig: Rig) -> Outcome:
    began_ns = time.time_ns()
    complaints = start_in_every_order(rig)
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
    origin_ns, end_ns, wrong = inject(fault, rig, config)
    ended_ns = time.time_ns()
    home_ns = _come_home(fault, rig, config)
    record = Record(
        sightings=[
            Sighting(
                time=(tick.sent_ns - origin_ns) * 1e-9, source=tick.source, reason=tick.reason
            )
            for tick in rig.watch.ticks
            if tick.sent_ns >= origin_ns
        ],
        commands=[(sent_ns - origin_ns) * 1e-9 for sent_ns in rig.watch.commands_ns],
        end=(end_ns - origin_ns) * 1e-9,
        over=(ended_ns - origin_ns) * 1e-9,
        home=None if home_ns is None else (home_ns - origin_ns) * 1e-9,
        unsound=[*wrong, *rig.watch.unsound[unsound:]],
        counted=_count(fault, rig) - counted,
        starved=[
            ((start - origin_ns) * 1e-9, (until - origin_ns) * 1e-9)
            for start, until in rig.odometry.starved_since(ended_ns)
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
    rig.spin(fault.recovery(config) + SLACK)
    deadline = time.monotonic() + fault.home
    while not rig.home and time.monotonic() < deadline:
        rig.spin(0.02)
    home_ns = time.time_ns() if rig.home else None
    rig.spin(_AFTER_HOME)
    return home_ns


def _count(fault: Fault, rig: Rig) -> int:
    return int(rig.watch.stats.get(fault.counter, 0))
