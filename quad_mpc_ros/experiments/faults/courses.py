"""Which rungs of the safety ladder a fault must lead to, and by when (``docs/safety.md``).

Times are seconds since the last good message before the fault, or since the fault began where it
is not one of messages. A rung is reached within one control period of its timeout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig


@dataclass(frozen=True)
class CoursePhase:
    """Sources one of which commands from ``begins`` at the earliest, ``reached`` at the latest."""

    sources: tuple[str, ...]
    begins: float = 0.0
    reached: float = 0.0


Course = tuple[CoursePhase, ...]
Spans = Sequence[tuple[CoursePhase, float, float]]
"""Phases, and from when to when."""

_WINDOW = ReferenceConfig().window_duration  # s

ANY = ("mpc", "plan", "hover", "blind", "silent", "idle")
_MPC, _MPC_OR_PLAN = CoursePhase(("mpc",)), CoursePhase(("mpc", "plan"))


def throughout(*sources: str) -> Callable[[MpcConfig], Course]:
    """One of the sources commands at any time."""
    return lambda config: (CoursePhase(sources),)


unaffected = throughout("mpc")


def accepted_after_timeout(config: MpcConfig) -> Course:
    """The plan is held until what is new has persisted for the timeout of the odometry."""
    reached = config.odom_timeout + 2.0 / config.control_rate
    return (_MPC_OR_PLAN, CoursePhase(("mpc",), reached=reached))


def clocks_apart(config: MpcConfig) -> Course:
    """The new stamps are accepted after the timeout, but the reference is of another time."""
    end = config.plan_hold_time
    return (
        _MPC_OR_PLAN,
        CoursePhase(("hover",), begins=end, reached=end + 1.0 / config.control_rate),
    )


def odometry_lost(config: MpcConfig, *, standing: bool = False) -> Course:
    """The MPC predicts, then blind (standing on the ground: idle at once), then silence."""
    late = 1.0 / config.control_rate
    # Standing on the ground nothing is predicted.
    predicted = config.odom_timeout if standing else _predicted(config)
    blind = max(predicted, config.plan_hold_time)
    silent = blind + config.blind_time
    return (
        _MPC,
        *_plan(predicted, blind, late=late, standing=standing),
        CoursePhase(("idle" if standing else "blind",), begins=blind, reached=blind + late),
        # The time of blindness counts from its first tick, which may be late by a period itself.
        CoursePhase(("silent",), begins=silent, reached=silent + 2.0 * late),
    )


def odometry_frozen(config: MpcConfig) -> Course:
    """As when it is lost, but plans are made of it until the timeout."""
    late, predicted = 1.0 / config.control_rate, _predicted(config)
    blind = max(predicted, config.odom_timeout + config.plan_hold_time)
    return (
        _MPC,
        *_plan(predicted, blind, late=late, standing=False),
        CoursePhase(("blind",), begins=blind - late, reached=blind + late),
    )


def _predicted(config: MpcConfig) -> float:
    """Return for how long without odometry the MPC plans on [s]."""
    return max(config.odom_timeout, config.odom_gap)


def reference_lost(config: MpcConfig, *, standing: bool = False) -> Course:
    """Plan, then hover (standing on the ground: idle at once)."""
    # The last plan is made just before the reference is too old, or reaches no longer far enough.
    reach = _WINDOW - config.horizon_steps * config.horizon_step
    since = max(config.reference_timeout, reach)
    return _no_new_plan(config, since=since, then="hover", standing=standing)


def solver_lost(config: MpcConfig, *, standing: bool = False) -> Course:
    """Plan at once, then hover (standing on the ground: idle at once)."""
    return _no_new_plan(config, since=0.0, then="hover", standing=standing)


def _no_new_plan(config: MpcConfig, *, since: float, then: str, standing: bool = False) -> Course:
    late = 1.0 / config.control_rate
    end = since + config.plan_hold_time
    return (
        _MPC,
        *_plan(since, end, late=late, standing=standing),
        CoursePhase(("idle" if standing else then,), begins=end - late, reached=end + late),
    )


def _plan(begins: float, ends: float, *, late: float, standing: bool) -> Course:
    """Return the phase of the last plan, unless it ends before it begins."""
    if begins >= ends:
        return ()
    return (CoursePhase(("idle" if standing else "plan",), begins=begins, reached=begins + late),)


def allowed(course: Course, time: float, *, slack: float) -> tuple[str, ...]:
    """Return the sources that may command at a time; ``slack`` [s] widens each phase."""
    ends = [*(phase.reached for phase in course[1:]), float("inf")]
    return tuple(
        source
        for phase, end in zip(course, ends, strict=True)
        if phase.begins - slack <= time <= end + slack
        for source in phase.sources
    )


def certain(course: Course, end: float, *, slack: float, least: float) -> Spans:
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
        sources = " or ".join(phase.sources) if phase.sources != ANY else "any"
        if phase.reached > 0.0:
            sources += f" by {phase.reached:.2f} s"
        words.append(sources)
    return ", ".join(words)
