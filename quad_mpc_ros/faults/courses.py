"""Which rungs of the safety ladder a fault must lead to, and by when (``docs/safety.md``).

Times are seconds since the last good message before the fault, or since the fault began where it
is not one of messages. A rung is reached within one control period of its timeout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from quad_mpc_ros.mpc_config import MpcConfig


@dataclass(frozen=True, kw_only=True)
class CoursePhase:
    """Sources one of which commands from ``begins`` at the earliest, ``reached`` at the latest."""

    sources: tuple[str, ...]
    begins: float
    reached: float


Course = tuple[CoursePhase, ...]

_ANY = ("mpc", "plan", "hover", "blind", "silent", "idle")


def unimpressed(config: MpcConfig) -> Course:
    """The MPC commands throughout."""
    return _course(("mpc", 0.0))


def held_at_most(config: MpcConfig) -> Course:
    """The MPC commands or, where a message is missing, its last plan."""
    return (CoursePhase(sources=("mpc", "plan"), begins=0.0, reached=0.0),)


def blind_at_most(config: MpcConfig) -> Course:
    """As before, or blind for the moment between the end of the plan and the next message."""
    return (CoursePhase(sources=("mpc", "plan", "blind"), begins=0.0, reached=0.0),)


def accepted_after_timeout(config: MpcConfig) -> Course:
    """The plan is held until what is new has persisted for the timeout of the odometry."""
    reached = config.odom_timeout + 2.0 / config.control_rate
    return (
        CoursePhase(sources=("mpc", "plan"), begins=0.0, reached=0.0),
        CoursePhase(sources=("mpc",), begins=0.0, reached=reached),
    )


def odometry_lost(config: MpcConfig, *, standing: bool = False) -> Course:
    """Plan, then blind (standing on the ground: idle at once), then silence."""
    late = 1.0 / config.control_rate
    plan, hold = _while_lost("blind", standing=standing)
    blind = max(config.odom_timeout, config.plan_hold_time)
    silent = blind + config.blind_time
    return (
        CoursePhase(sources=("mpc",), begins=0.0, reached=0.0),
        *_lasting(plan, config.odom_timeout, blind, late),
        CoursePhase(sources=(hold,), begins=blind, reached=blind + late),
        # The time of blindness counts from its first tick, which may be late by a period itself.
        CoursePhase(sources=("silent",), begins=silent, reached=silent + 2.0 * late),
    )


def clocks_apart(config: MpcConfig) -> Course:
    """The new stamps are believed after the timeout, but the reference is of another time."""
    late = 1.0 / config.control_rate
    end = config.plan_hold_time
    return (
        CoursePhase(sources=("mpc", "plan"), begins=0.0, reached=0.0),
        CoursePhase(sources=("hover",), begins=end, reached=end + late),
    )


def odometry_frozen(config: MpcConfig) -> Course:
    """As when it is lost, but plans are made of it until the timeout."""
    late = 1.0 / config.control_rate
    blind = config.odom_timeout + config.plan_hold_time
    return (
        CoursePhase(sources=("mpc",), begins=0.0, reached=0.0),
        *_lasting("plan", config.odom_timeout, blind, late),
        CoursePhase(sources=("blind",), begins=blind - late, reached=blind + late),
    )


def reference_lost(config: MpcConfig, *, standing: bool = False) -> Course:
    """Plan, then hover (standing on the ground: idle at once)."""
    late = 1.0 / config.control_rate
    plan, hold = _while_lost("hover", standing=standing)
    # The last plan is made just before the reference is too old.
    end = config.reference_timeout + config.plan_hold_time
    return (
        CoursePhase(sources=("mpc",), begins=0.0, reached=0.0),
        *_lasting(plan, config.reference_timeout, end, late),
        CoursePhase(sources=(hold,), begins=end - late, reached=end + late),
    )


def solver_lost(config: MpcConfig, *, standing: bool = False) -> Course:
    """Plan at once, then hover (standing on the ground: idle at once)."""
    late = 1.0 / config.control_rate
    plan, hold = _while_lost("hover", standing=standing)
    end = config.plan_hold_time
    return (
        CoursePhase(sources=("mpc",), begins=0.0, reached=0.0),
        *_lasting(plan, 0.0, end, late),
        CoursePhase(sources=(hold,), begins=end - late, reached=end + late),
    )


def anything(config: MpcConfig) -> Course:
    """Whatever is sound: the controller does not run, and what comes first is chance."""
    return (CoursePhase(sources=_ANY, begins=0.0, reached=0.0),)


def allowed(course: Course, time: float, *, slack: float) -> tuple[str, ...]:
    """Return the sources that may command at a time; ``slack`` [s] widens each phase."""
    ends = [*(phase.reached for phase in course[1:]), float("inf")]
    return tuple(
        source
        for phase, end in zip(course, ends, strict=True)
        if phase.begins - slack <= time <= end + slack
        for source in phase.sources
    )


def certain(
    course: Course, end: float, *, slack: float, least: float
) -> Sequence[tuple[CoursePhase, float, float]]:
    """Return the phases that must be seen before ``end``, and from when to when they are alone.

    Those are left out that are alone for less than ``least`` seconds.
    """
    ends = [*(phase.begins for phase in course[1:]), end]
    spans = [
        (phase, phase.reached + slack, min(until, end) - slack)
        for phase, until in zip(course, ends, strict=True)
        if phase.reached > 0.0
    ]
    return [(phase, start, until) for phase, start, until in spans if until - start >= least]


def described(course: Course, end: float) -> str:
    """Return in words what a course is until ``end``."""
    words = []
    for phase in course:
        if phase.begins > end:
            break
        sources = " or ".join(phase.sources) if phase.sources != _ANY else "any"
        if phase.reached > 0.0:
            sources += f" by {phase.reached:.2f} s"
        words.append(sources)
    return ", ".join(words)


def _while_lost(hold: str, *, standing: bool) -> tuple[str, str]:
    """Return who commands at first and after the plan."""
    return ("idle", "idle") if standing else ("plan", hold)


def _lasting(source: str, begins: float, ends: float, late: float) -> Course:
    """Return a phase, unless it ends before it begins."""
    if begins >= ends:
        return ()
    return (CoursePhase(sources=(source,), begins=begins, reached=begins + late),)


def _course(*phases: tuple[str, float]) -> Course:
    return tuple(CoursePhase(sources=(s,), begins=begins, reached=begins) for s, begins in phases)
