"""A long flight with lost odometries and parameter changes: lateness, fallbacks, memory."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quad_mpc_ros.commands.progress import Progress
from quad_mpc_ros.commands.soak.bare_timer import BareTimer, Wakes
from quad_mpc_ros.commands.soak.rig import Rig
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.experiments.faults.parameter_changes import good_changes
from quad_mpc_ros.recordings.evaluation.crash import crash_figures, crash_text
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

_MEGABYTE = 1e6
_GROWTH_ALLOWED = 5.0  # MB
_LATE_ALLOWED = 1e-4  # of the ticks
_WARM_UP_SHARE, _LONGEST_WARM_UP = 0.2, 60.0  # of the duration; s
_PERIOD = 1.0  # s between two changes of parameters
# After the machine stood still, nodes have to catch up with their clocks.
PERIODS_TO_CATCH_UP = 5
_END_SHARE = 0.1  # of the time after the warm-up: its memory is compared


@dataclass
class Endurance:
    """What was observed; times of the system clock [ns]."""

    began_ns: int
    ended_ns: int = 0
    changes: int = 0
    refused: list[str] = field(default_factory=list)
    machine: Wakes | None = None


def endure(rig: Rig, config: MpcConfig, *, duration: float) -> Endurance:
    """Fly for ``duration`` seconds; raises :class:`SoakError` when the flight ends early."""
    rig.fly()
    rig.watch.forget()
    seen = Endurance(began_ns=time.time_ns())
    timer = BareTimer(1.0 / config.control_rate)
    changes = good_changes(config)
    progress = Progress(duration)
    started = time.monotonic()
    while time.monotonic() - started < duration:
        change = next(changes)
        answer = rig.set_parameters(change)
        due = started + (seen.changes + 1) * _PERIOD
        rig.spin(max(min(due, started + duration) - time.monotonic(), 0.0))
        rig.wait(answer.done, "the answer to a change of parameters")
        seen.changes += 1
        if not answer.result().result.successful:
            seen.refused.append(answer.result().result.reason)
        if progress.due:
            progress.show(time.monotonic() - started, rig.position_error)
    progress.close()
    seen.machine = timer.stop()
    # What answers the last odometry is still on its way.
    rig.spin(0.2)
    seen.ended_ns = time.time_ns()
    return seen


def figures(rig: Rig, seen: Endurance, config: MpcConfig) -> dict[str, Any]:
    """Return the figures of an endurance."""
    period_ms = 1e3 / config.control_rate
    lateness = rig.watch.lateness_ms()
    late_ns = [
        tick.sent_ns
        for tick, late in zip(rig.watch.ticks, lateness, strict=True)
        if late > period_ms
    ]
    unanswered_ns = rig.watch.unanswered_ns()
    sources = Counter(tick.source for tick in rig.watch.ticks)
    return {
        "duration_s": (seen.ended_ns - seen.began_ns) * 1e-9,
        "ticks": len(rig.watch.ticks),
        "sources": dict(sources),
        "late_ticks": len(late_ns),
        "unanswered_odometries": len(unanswered_ns),
        "machine": _machine(
            seen, [*late_ns, *unanswered_ns], margin=1e-3 * PERIODS_TO_CATCH_UP * period_ms
        ),
        "odom_to_stats_ms": percentiles(lateness, 50, 99),
        "memory_mb": _memory(rig, seen),
        "parameter_changes": seen.changes,
        "parameters_refused": seen.refused,
        "unsound_commands": len(rig.watch.unsound),
        **crash_figures(rig.motion.crash()),
    }


def endurance_complaints(figures: dict[str, Any], unsound: list[str]) -> list[str]:
    """Return all that is wrong with the figures of an endurance."""
    wrong = list(unsound[:1])
    if figures["crashed"]:
        wrong.append(crash_text(figures["crash"], figures["crash_time_s"]))
    beyond = {s: n for s, n in figures["sources"].items() if s not in ("mpc", "plan")}
    if beyond:
        counts = ", ".join(f"{name} {count}" for name, count in beyond.items())
        wrong.append(f"ticks beyond the last plan: {counts}")
    if not figures["sources"].get("mpc"):
        wrong.append("the MPC never commanded")
    late = figures["late_ticks"] + figures["unanswered_odometries"]
    if late >= _LATE_ALLOWED * figures["ticks"] and late > 0:
        share = late / max(figures["ticks"], 1)
        wrong.append(
            f"{late} of {figures['ticks']} ticks late by more than a period or missing: "
            f"{share:.3%}, expected less than {_LATE_ALLOWED:.2%}"
        )
    memory = figures["memory_mb"]
    if memory["growth"] is None:
        wrong.append("too short to judge the growth of memory")
    elif memory["growth"] >= _GROWTH_ALLOWED:
        wrong.append(
            f"memory grew by {memory['growth']:.1f} MB, expected less than {_GROWTH_ALLOWED:g} MB"
        )
    if figures["parameters_refused"]:
        wrong.append(f"a change of parameters was refused: {figures['parameters_refused'][0]}")
    return wrong


def _machine(seen: Endurance, late_ns: list[int], *, margin: float) -> dict[str, Any] | None:
    """Return the lateness of the bare timer, and how many ticks were late while it was.

    Also returns the share of time of these stalls, ``margin`` seconds around them included: late
    ticks that are unrelated occur then as often as at any other time.
    """
    if seen.machine is None:
        return None
    stalls = seen.machine.stalls(margin=margin)
    return {
        "wakes": seen.machine.count,
        "late_wakes": len(seen.machine.late),
        "latest_ms": seen.machine.latest,
        "late_ticks_then": sum(
            any(begin <= late <= end for begin, end in stalls) for late in late_ns
        ),
        "share_of_time": sum(end - begin for begin, end in stalls)
        / max(seen.ended_ns - seen.began_ns, 1),
    }


def _memory(rig: Rig, seen: Endurance) -> dict[str, float | None]:
    """Return the memory after warming up, and how much it has grown since [MB]."""
    warm_up = min(_WARM_UP_SHARE * (seen.ended_ns - seen.began_ns), _LONGEST_WARM_UP * 1e9)
    warm = [memory for when, memory in rig.memory if when >= seen.began_ns + warm_up]
    if len(warm) < 2:
        return {"warm": None, "growth": None}
    share = max(round(_END_SHARE * len(warm)), 1)
    before, after = np.median(warm[:share]), np.median(warm[-share:])
    return {"warm": float(before) / _MEGABYTE, "growth": float(after - before) / _MEGABYTE}
