"""The status of a vehicle as labelled texts, each with a mark; nothing of how it looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from quad_mpc_ros.commands.watch.vehicle import LogLine, Vehicle
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.voltage import measured_voltage
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import (
    BATTERY,
    COMMAND,
    ENGAGED,
    LANDED,
    ODOMETRY,
    REFERENCE,
    Topic,
)

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


@dataclass(frozen=True)
class Entry:
    """A text with its mark."""

    text: str
    mark: Mark = Mark.PLAIN

    def aged(self, age: float | None, limit: float = _OLD) -> Entry:
        """Return it marked with its age [s] if that exceeds the limit."""
        if age is None or age <= limit or self.mark is Mark.MISSING:
            return self
        return Entry(f"{self.text} (old: {age:.0f} s)", Mark.OLD)


@dataclass(frozen=True, kw_only=True)
class VehicleView:
    """The status of one vehicle, by label in the order of the table; and its log, by node."""

    name: str
    entries: dict[str, Entry]
    log: tuple[tuple[str, Entry], ...]


MISSING = Entry("-", Mark.MISSING)
_NOT_PUBLISHED = Entry("not published", Mark.MISSING)


def viewed(vehicle: Vehicle, now: float) -> VehicleView:
    """Return the status of a vehicle at a time [s], as of its last :meth:`Vehicle.look`."""
    return VehicleView(
        name=vehicle.namespace or "/",
        entries={
            "commands": _source(vehicle),
            **_flight(vehicle, now),
            **_motion(vehicle, now),
            **_timing(vehicle, now),
            **_counters(vehicle),
            **_estimates(vehicle),
            **{f"node {name}": _node(vehicle, name, now) for name in sorted(vehicle.health)},
        },
        log=tuple(_logged(line) for line in vehicle.log),
    )


def _source(vehicle: Vehicle) -> Entry:
    """Return the active source, and why if it is not the MPC."""
    stats = vehicle.stats
    if stats is None:
        return Entry("no mpc/stats yet", Mark.MISSING)
    mark = {"mpc": Mark.GOOD, "plan": Mark.WARN, "waiting": Mark.WARN}.get(stats.source, Mark.BAD)
    text = f"{stats.source}: {stats.reason}" if stats.reason else stats.source
    return Entry(text, mark).aged(vehicle.stats_age)


def _flight(vehicle: Vehicle, now: float) -> dict[str, Entry]:
    reference = vehicle.health.get("reference")
    entries = {"ground": _of_stats(vehicle, lambda stats: stats.ground)}
    for label, key in (("mode", "mode"), ("request", "request")):
        entries[label] = MISSING
        if reference is not None:
            text = reference.values.get(key, "")
            entry = Entry(text or "-", Mark.WARN if " refused: " in text else Mark.PLAIN)
            entries[label] = entry.aged(now - reference.seconds, _SILENT_NODE)
    for topic, mark in ((ENGAGED, Mark.WARN), (LANDED, Mark.PLAIN)):
        flag = vehicle.read(topic, lambda message: bool(message.data))
        flags = {None: _NOT_PUBLISHED, True: Entry("yes"), False: Entry("no", mark)}
        entries[topic.name] = flags[flag]
    voltage = vehicle.read(BATTERY, lambda message: measured_voltage(float(message.voltage)))
    battery = _NOT_PUBLISHED if voltage is None else Entry(f"{voltage:.2f} V")
    return {**entries, "battery": battery.aged(_age(vehicle, BATTERY, now))}


def _motion(vehicle: Vehicle, now: float) -> dict[str, Entry]:
    odometry = vehicle.read(ODOMETRY, _usable_odometry)
    if odometry is None:
        return dict.fromkeys(("position", "speed", "error"), MISSING)
    x, y, z = odometry.p_WB.tolist()
    age = _age(vehicle, ODOMETRY, now)
    return {
        "position": Entry(f"{x:z.2f} {y:z.2f} {z:z.2f} m").aged(age),
        "speed": Entry(f"{odometry.speed:.2f} m/s").aged(age),
        "error": _error(vehicle, odometry).aged(
            max(age or 0.0, _age(vehicle, REFERENCE, now) or 0.0)
        ),
    }


def _usable_odometry(message: Any) -> OdometrySample | None:
    odometry = conversions.odometry_from_message(message)
    return odometry if odometry_fault(odometry, frame_id=odometry.frame_id) is None else None


def _error(vehicle: Vehicle, odometry: OdometrySample) -> Entry:
    """Return the distance to the reference."""
    position = vehicle.read(
        REFERENCE,
        lambda message: conversions.reference_from_message(message).pose_at(odometry.stamp_ns)[0],
    )
    error = np.nan if position is None else float(np.linalg.norm(position - odometry.p_WB))
    if not np.isfinite(error):
        return MISSING
    mark = Mark.BAD if error > _VERY_FAR else Mark.WARN if error > _FAR else Mark.PLAIN
    return Entry(f"{error:.3f} m", mark)


def _timing(vehicle: Vehicle, now: float) -> dict[str, Entry]:
    entries = {}
    for topic in (ODOMETRY, REFERENCE, COMMAND):
        age = _age(vehicle, topic, now)
        entries[topic.name] = Entry("none yet", Mark.MISSING)
        if age is not None:
            rate = vehicle.topics[topic.name].rate(now)
            mark = Mark.OLD if age > _OLD else Mark.PLAIN
            entries[topic.name] = Entry(f"{rate:.0f} Hz, {age:.2f} s ago", mark)
    return {
        **entries,
        "latency": _of_stats(
            vehicle,
            lambda stats: f"{stats.odom_age_ms:.1f} ms",
            warn=lambda stats: not 0.0 <= stats.odom_age_ms <= _LATE_ODOMETRY,
        ),
        "step": _of_stats(vehicle, lambda stats: f"{1e-3 * stats.step_time_us:.2f} ms"),
        "solver": _of_stats(
            vehicle,
            lambda stats: f"{stats.solver_status}, {stats.iterations} iterations",
            warn=lambda stats: stats.solver_status not in ("solved", "not run"),
        ),
    }


def _counters(vehicle: Vehicle) -> dict[str, Entry]:
    """Return what has been counted since the start; failures that rise are marked."""

    def counted(name: str) -> Entry:
        return _of_stats(
            vehicle,
            lambda stats: str(getattr(stats, name)),
            warn=lambda _: name != "commands" and vehicle.has_risen(name),
        )

    return {
        "commands sent": counted("commands"),
        "fallbacks": counted("fallbacks"),
        "solver failures": counted("solver_failures"),
        "deadline misses": counted("deadline_misses"),
        "rejected inputs": counted("rejected_inputs"),
    }


def _estimates(vehicle: Vehicle) -> dict[str, Entry]:
    def status(stats: TickStats) -> str:
        resets = f", {stats.estimate_resets} resets" if stats.estimate_resets else ""
        return f"{stats.estimate}{resets}"

    def figure(name: str, form: str) -> Entry:
        return _of_stats(vehicle, lambda stats: form.format(getattr(stats, name)))

    return {
        "estimate": _of_stats(
            vehicle, status, warn=lambda stats: stats.estimate in ("at bounds", "reset")
        ),
        "thrust scale": figure("thrust_scale", "{:.3f}"),
        **{f"disturbance {a}": figure(f"disturbance_{a}", "{:z.2f} m/s²") for a in "xyz"},
        "drag": figure("drag", "{:.2f} 1/s"),
        "rate lag": figure("rate_time_constant_ms", "{:.0f} ms"),
        "yaw lag": figure("yaw_time_constant_ms", "{:.0f} ms"),
        "thrust lag": figure("thrust_time_constant_ms", "{:.0f} ms"),
    }


def _node(vehicle: Vehicle, name: str, now: float) -> Entry:
    health = vehicle.health[name]
    level = _LEVELS[health.level] if 0 <= health.level < len(_LEVELS) else str(health.level)
    mark = {"OK": Mark.GOOD, "WARN": Mark.WARN}.get(level, Mark.BAD)
    return Entry(f"{level} {health.text}", mark).aged(now - health.seconds, _SILENT_NODE)


def _logged(line: LogLine) -> tuple[str, Entry]:
    mark = Mark.BAD if line.level >= _ERROR else Mark.WARN if line.level >= _WARN else Mark.PLAIN
    return line.node, Entry(line.text, mark)


def _of_stats(
    vehicle: Vehicle,
    text: Callable[[TickStats], str],
    *,
    warn: Callable[[TickStats], bool] = lambda stats: False,
) -> Entry:
    """Return a figure of the newest tick; the entry of the source states its age."""
    stats = vehicle.stats
    if stats is None:
        return MISSING
    if vehicle.stats_age is not None and vehicle.stats_age > _OLD:
        return Entry(text(stats), Mark.OLD)
    return Entry(text(stats), Mark.WARN if warn(stats) else Mark.PLAIN)


def _age(vehicle: Vehicle, topic: Topic, now: float) -> float | None:
    return vehicle.topics[topic.name].age(now)
