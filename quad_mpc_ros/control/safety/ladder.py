# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The safety ladder: the active source, and the reason (docs/explanation/safety.md).

A pure state machine from inputs and state to a decision and the new state. The ladder reads no
clock; all times are in nanoseconds of one clock of the caller.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig

_SECOND = 1_000_000_000
_PREDICTED = "odometry is late: predicted"


class Source(enum.IntEnum):
    """The source of the command. Higher is more severe; the last two publish nothing."""

    MPC = 0
    PLAN = 1
    HOVER = 2
    IDLE = 3
    BLIND = 4
    SILENT = 5
    WAITING = 6


class Action(enum.IntEnum):
    """The action on a breach of a limit; higher is more severe."""

    WARN = 0
    HOVER = 1
    DESCEND = 2
    STOP = 3


class Breach(NamedTuple):
    """A breached limit of the flight (``control/safety/flight_limits.py``)."""

    action: Action
    reason: str


class Decision(NamedTuple):
    """The failsafe level and its reason, empty in normal operation."""

    source: Source
    reason: str = ""


class Timeouts(NamedTuple):
    """Timeouts [ns]; ``gap`` is the longest prediction without odometry."""

    odometry: int
    gap: int
    plan_hold: int
    blind: int


class LadderInputs(NamedTuple):
    """Inputs of a decision.

    ``odometry_ns`` is the arrival of the last usable odometry. ``plan_fault`` is the reason for a
    missing plan, else empty. ``on_ground`` includes a crashed vehicle. ``is_predicted``: the plan
    starts at a state predicted without odometry. ``jumped`` is the reason for replacing the
    odometry's position, else empty.
    """

    now_ns: int
    odometry_ns: int | None
    plan_fault: str = ""
    breach: Breach | None = None
    on_ground: bool = False
    is_predicted: bool = False
    jumped: str = ""


class LadderState(NamedTuple):
    """State of the ladder.

    ``planned_ns`` is the time of the last plan from an odometry, ``blind_since_ns`` the start of
    flight by dead reckoning, ``stopped`` the reason for a final stop.
    """

    planned_ns: int | None = None
    blind_since_ns: int | None = None
    stopped: str = ""


def timeouts_of(config: MpcConfig) -> Timeouts:
    """Return the timeouts of a configuration."""
    return Timeouts(
        odometry=round(config.odom_timeout * _SECOND),
        gap=round(max(config.odom_timeout, config.odom_gap) * _SECOND),
        plan_hold=round(config.plan_hold_time * _SECOND),
        blind=round(config.blind_time * _SECOND),
    )


def decide(
    inputs: LadderInputs, state: LadderState, timeouts: Timeouts
) -> tuple[Decision, LadderState]:
    """Return the decision and the next state."""
    has_odometry = _is_within(inputs.odometry_ns, inputs.now_ns, timeouts.odometry)
    fault = _odometry_fault(inputs, timeouts, has_odometry) or inputs.plan_fault
    # Plans from predicted states give the fallbacks no more time.
    planned_ns = state.planned_ns if fault or inputs.is_predicted else inputs.now_ns
    if planned_ns is None:
        return Decision(Source.WAITING, fault), state
    holding = _is_within(planned_ns, inputs.now_ns, timeouts.plan_hold)
    # Without odometry, the last known position breaches nothing.
    descends = inputs.breach is not None and inputs.breach.action is Action.DESCEND
    breach = inputs.breach if has_odometry or descends else None
    # While the plan holds the vehicle is not blind.
    is_blind = descends or not (has_odometry or holding or not fault)
    blind_since_ns = inputs.now_ns if state.blind_since_ns is None else state.blind_since_ns
    stopped = breach.reason if breach is not None and breach.action is Action.STOP else ""
    state = LadderState(
        planned_ns=planned_ns,
        blind_since_ns=blind_since_ns if is_blind else None,
        stopped=state.stopped or stopped,
    )
    return _level(inputs, state, timeouts, fault=fault, breach=breach, holding=holding), state


def _level(
    inputs: LadderInputs,
    state: LadderState,
    timeouts: Timeouts,
    *,
    fault: str,
    breach: Breach | None,
    holding: bool,
) -> Decision:
    if state.stopped:
        return Decision(Source.SILENT, state.stopped)
    if breach is not None and breach.action is Action.HOVER:
        return Decision(Source.IDLE if inputs.on_ground else Source.HOVER, breach.reason)
    if breach is not None and breach.action is Action.DESCEND:
        fault = breach.reason
    elif not fault:
        note = _PREDICTED if inputs.is_predicted else inputs.jumped
        return Decision(Source.MPC, breach.reason if breach is not None else note)
    elif holding and not inputs.on_ground:  # a plan may take off later
        return Decision(Source.PLAN, fault)
    if state.blind_since_ns is None:
        return Decision(Source.IDLE if inputs.on_ground else Source.HOVER, fault)
    if _is_within(state.blind_since_ns, inputs.now_ns, timeouts.blind):
        return Decision(Source.IDLE if inputs.on_ground else Source.BLIND, fault)
    return Decision(Source.SILENT, fault)


def _odometry_fault(inputs: LadderInputs, timeouts: Timeouts, has_odometry: bool) -> str:
    if inputs.odometry_ns is None:
        return "no odometry yet"
    if inputs.is_predicted:
        has_odometry = _is_within(inputs.odometry_ns, inputs.now_ns, timeouts.gap)
    if not has_odometry:
        return f"odometry is {(inputs.now_ns - inputs.odometry_ns) / _SECOND:.2f} s old"
    return ""


def _is_within(since_ns: int | None, now_ns: int, duration_ns: int) -> bool:
    """Whether a time is at most a duration away, also in the future: clocks may be set back."""
    return since_ns is not None and -duration_ns <= now_ns - since_ns <= duration_ns
