"""What a picture of a vehicle says: labelled texts, each with a mark; nothing of how it looks.

What is missing is told as missing, and what is old with its age.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from quad_mpc_ros.commands.watch.vehicle import LogLine, Sample, Vehicle
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages.topics import (
    BATTERY,
    COMMAND,
    ENGAGED,
    LANDED,
    ODOMETRY,
    REFERENCE,
    STATS,
    Topic,
)

NOTHING = "-"
_OLD = 1.0  # s: then figures are of the past
_SILENT_NODE = 3.0  # s, nodes report once a second
_FAR, _VERY_FAR = 0.3, 1.0  # m
_LATE_ODOMETRY = 50.0  # ms, by its stamp
_WARN, _ERROR = 30, 40  # of rcl_interfaces/Log
_LEVELS = ("OK", "WARN", "ERROR")


class Mark(Enum):
    """How good what a text says is."""

    PLAIN = "plain"
    GOOD = "good"
    WARN = "warn"
    BAD = "bad"
    OLD = "old"
    MISSING = "missing"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A text with its label."""

    label: str
    text: str
    mark: Mark = Mark.PLAIN


@dataclass(frozen=True, kw_only=True, eq=False)
class VehicleView:
    """One vehicle, for a panel or a row. ``trail`` (n, 3) [m] is where it was lately."""

    name: str
    rung: Entry
    flight: tuple[Entry, ...]
    motion: tuple[Entry, ...]
    learned: tuple[Entry, ...]
    timing: tuple[Entry, ...]
    counters: tuple[Entry, ...]
    nodes: tuple[Entry, ...]
    log: tuple[Entry, ...]
    trail: Array

    def entry(self, label: str) -> Entry:
        """Return the entry with a label."""
        groups = (self.flight, self.motion, self.learned, self.timing, self.counters)
        return next(entry for group in groups for entry in group if entry.label == label)


def looked_at(vehicles: Iterable[Vehicle], now: float) -> list[VehicleView]:
    """Look at vehicles at a time [s], and return the picture of each."""
    views = []
    for vehicle in vehicles:
        vehicle.look(now)
        views.append(viewed(vehicle, now))
    return views


def viewed(vehicle: Vehicle, now: float) -> VehicleView:
    """Return the picture of a vehicle at a time [s], as it was last looked at."""
    return VehicleView(
        name=vehicle.namespace or "/",
        rung=_rung(vehicle, now),
        flight=_flight(vehicle, now),
        motion=_motion(vehicle, now),
        learned=_learned(vehicle, now),
        timing=_timing(vehicle, now),
        counters=_counters(vehicle, now),
        nodes=tuple(_node(vehicle, name, now) for name in sorted(vehicle.health)),
        log=tuple(_line(line) for line in vehicle.log),
        trail=vehicle.trail,
    )


def _rung(vehicle: Vehicle, now: float) -> Entry:
    """Return who commands, and why if not the MPC."""
    stats = vehicle.stats
    if stats is None:
        return Entry(label="commands", text="no mpc/stats yet", mark=Mark.MISSING)
    mark = {"mpc": Mark.GOOD, "plan": Mark.WARN, "waiting": Mark.WARN}.get(stats.source, Mark.BAD)
    text = f"{stats.source}: {stats.reason}" if stats.reason else stats.source
    return _dated(vehicle, STATS, now, Entry(label="commands", text=text, mark=mark))


def _flight(vehicle: Vehicle, now: float) -> tuple[Entry, ...]:
    reference = vehicle.health.get("reference")
    mode = _of_stats(vehicle, now, "ground", lambda stats: stats.ground)
    entries = [mode]
    for label, key in (("reference", "mode"), ("request", "request")):
        text = reference.values.get(key, "") if reference is not None else ""
        refused = " refused: " in text
        entry = Entry(label=label, text=text or NOTHING, mark=Mark.WARN if refused else Mark.PLAIN)
        if reference is None:
            entry = Entry(label=label, text=NOTHING, mark=Mark.MISSING)
        elif now - reference.seconds > _SILENT_NODE:
            entry = _old(entry, now - reference.seconds)
        entries.append(entry)
    for label, topic, mark in (("engaged", ENGAGED, Mark.WARN), ("landed", LANDED, Mark.PLAIN)):
        flag = vehicle.flag(topic)
        text = {True: "yes", False: "no", None: "not published"}[flag]
        kind = {True: Mark.PLAIN, False: mark, None: Mark.MISSING}[flag]
        entries.append(Entry(label=label, text=text, mark=kind))
    voltage = vehicle.voltage
    battery = Entry(label="battery", text="not published", mark=Mark.MISSING)
    if voltage is not None:
        battery = _dated(vehicle, BATTERY, now, Entry(label="battery", text=f"{voltage:.2f} V"))
    return (*entries, battery)


def _motion(vehicle: Vehicle, now: float) -> tuple[Entry, ...]:
    odometry = vehicle.odometry
    if odometry is None:
        missing = [Entry(label=x, text=NOTHING, mark=Mark.MISSING) for x in ("position", "speed")]
    else:
        x, y, z = odometry.p_WB.tolist()
        missing = [
            _dated(vehicle, ODOMETRY, now, entry)
            for entry in (
                Entry(label="position", text=f"{x:z.2f} {y:z.2f} {z:z.2f} m"),
                Entry(label="speed", text=f"{odometry.speed:.2f} m/s"),
            )
        ]
    return (*missing, _error(vehicle, now))


def _error(vehicle: Vehicle, now: float) -> Entry:
    error, spread = vehicle.error, vehicle.spread(lambda each: each.error)
    if error is None or spread is None:
        return Entry(label="error", text=NOTHING, mark=Mark.MISSING)
    mark = Mark.BAD if error > _VERY_FAR else Mark.WARN if error > _FAR else Mark.PLAIN
    entry = Entry(label="error", text=f"{error:.3f} m (most {spread[1]:.3f})", mark=mark)
    return _dated(vehicle, ODOMETRY, now, _dated(vehicle, REFERENCE, now, entry))


def _learned(vehicle: Vehicle, now: float) -> tuple[Entry, ...]:
    def entry(label: str, name: str, unit: str, digits: int) -> Entry:
        def figure(stats: TickStats) -> float:
            return float(getattr(stats, name))

        def of_sample(sample: Sample) -> float | None:
            return None if sample.stats is None else figure(sample.stats)

        def text(stats: TickStats) -> str:
            low, high = vehicle.spread(of_sample) or (figure(stats),) * 2
            here, least, most = (f"{each:z.{digits}f}" for each in (figure(stats), low, high))
            return f"{here} [{least}, {most}]{unit}"

        return _of_stats(vehicle, now, label, text)

    def status(stats: TickStats) -> str:
        resets = f", {stats.estimate_resets} resets" if stats.estimate_resets else ""
        return f"{stats.estimate}{resets}"

    estimate = _of_stats(
        vehicle, now, "estimate", status, warn=lambda s: s.estimate in ("at bounds", "reset")
    )
    return (
        estimate,
        entry("thrust scale", "thrust_scale", "", 3),
        *(entry(f"disturbance {a}", f"disturbance_{a}", " m/s²", 2) for a in "xyz"),
        entry("drag", "drag", " 1/s", 2),
        entry("rate lag", "rate_time_constant_ms", " ms", 0),
        entry("yaw lag", "yaw_time_constant_ms", " ms", 0),
        entry("thrust lag", "thrust_time_constant_ms", " ms", 0),
    )


def _timing(vehicle: Vehicle, now: float) -> tuple[Entry, ...]:
    entries = []
    for topic in (ODOMETRY, REFERENCE, COMMAND):
        arrivals = vehicle.topics[topic.name]
        age = arrivals.age(now)
        if age is None:
            entries.append(Entry(label=topic.name, text="none yet", mark=Mark.MISSING))
            continue
        text = f"{arrivals.rate(now):.0f} Hz, {age:.2f} s ago"
        mark = Mark.OLD if age > _OLD else Mark.PLAIN
        entries.append(Entry(label=topic.name, text=text, mark=mark))
    return (
        *entries,
        _of_stats(
            vehicle,
            now,
            "latency",
            lambda stats: f"{stats.odom_age_ms:.1f} ms",
            warn=lambda stats: not 0.0 <= stats.odom_age_ms <= _LATE_ODOMETRY,
        ),
        _of_stats(vehicle, now, "step", lambda stats: f"{1e-3 * stats.step_time_us:.2f} ms"),
        _of_stats(
            vehicle,
            now,
            "solver",
            lambda stats: f"{stats.solver_status}, {stats.iterations} iterations",
            warn=lambda stats: stats.solver_status not in ("solved", "not run"),
        ),
    )


def _counters(vehicle: Vehicle, now: float) -> tuple[Entry, ...]:
    """Return what has been counted since the start; what rises is marked."""

    def entry(label: str, name: str) -> Entry:
        def count(stats: TickStats) -> int:
            return int(getattr(stats, name))

        def rises(stats: TickStats) -> bool:
            spread = vehicle.spread(lambda each: None if each.stats is None else count(each.stats))
            return name != "commands" and spread is not None and count(stats) > spread[0]

        return _of_stats(vehicle, now, label, lambda stats: str(count(stats)), warn=rises)

    return (
        entry("commands sent", "commands"),
        entry("fallbacks", "fallbacks"),
        entry("solver failures", "solver_failures"),
        entry("deadline misses", "deadline_misses"),
        entry("rejected inputs", "rejected_inputs"),
    )


def _node(vehicle: Vehicle, name: str, now: float) -> Entry:
    health = vehicle.health[name]
    level = _LEVELS[health.level] if 0 <= health.level < len(_LEVELS) else str(health.level)
    mark = {"OK": Mark.GOOD, "WARN": Mark.WARN}.get(level, Mark.BAD)
    entry = Entry(label=name, text=f"{level} {health.text}", mark=mark)
    silent = now - health.seconds
    return _old(entry, silent) if silent > _SILENT_NODE else entry


def _line(line: LogLine) -> Entry:
    mark = Mark.BAD if line.level >= _ERROR else Mark.WARN if line.level >= _WARN else Mark.PLAIN
    return Entry(label=line.node, text=line.text, mark=mark)


def _of_stats(
    vehicle: Vehicle,
    now: float,
    label: str,
    text: Callable[[TickStats], str],
    *,
    warn: Callable[[TickStats], bool] = lambda stats: False,
) -> Entry:
    """Return what the figures of the newest tick say."""
    stats = vehicle.stats
    if stats is None:
        return Entry(label=label, text=NOTHING, mark=Mark.MISSING)
    mark = Mark.WARN if warn(stats) else Mark.PLAIN
    entry = Entry(label=label, text=text(stats), mark=mark)
    age = vehicle.topics[STATS.name].age(now)
    # The rung tells the age of them all.
    return Entry(label=label, text=entry.text, mark=Mark.OLD) if age and age > _OLD else entry


def _dated(vehicle: Vehicle, topic: Topic, now: float, entry: Entry) -> Entry:
    """Return an entry as old if the newest message of its topic is."""
    age = vehicle.topics[topic.name].age(now)
    return _old(entry, age) if age is not None and age > _OLD else entry


def _old(entry: Entry, age: float) -> Entry:
    if entry.mark is Mark.OLD:
        return entry
    return Entry(label=entry.label, text=f"{entry.text} (old: {age:.0f} s)", mark=Mark.OLD)


def extent(trail: Array) -> float:
    """Return the longer side [m] of what a trail (n, 3) covers from above."""
    return float(np.ptp(trail[:, :2], axis=0).max()) if len(trail) else 0.0
