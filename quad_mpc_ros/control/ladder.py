"""The safety ladder: which source commands the vehicle, and why (see ``docs/safety.md``)."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from quad_mpc_ros.control.config import MpcConfig

_SECOND = 1_000_000_000


class Source(enum.IntEnum):
    """Who commands the vehicle. Higher is further from normal; SILENT publishes nothing."""

    MPC = 0
    PLAN = 1
    HOVER = 2
    BLIND = 3
    SILENT = 4
    WAITING = 5


@dataclass(frozen=True, kw_only=True)
class Decision:
    """The rung of the ladder and the reason for it; empty when all is well."""

    source: Source
    reason: str = ""


class SafetyLadder:
    """Chooses the source of the command from ages and the solver's outcome. Pure but for memory.

    It remembers the stamp of the last plan and since when it has been blind. All times are in
    nanoseconds of whatever one clock the caller uses.
    """

    def __init__(self, config: MpcConfig) -> None:
        self._odom_timeout = round(config.odom_timeout * _SECOND)
        self._reference_timeout = round(config.reference_timeout * _SECOND)
        self._plan_hold_time = round(config.plan_hold_time * _SECOND)
        self._blind_time = round(config.blind_time * _SECOND)
        self._planned_ns: int | None = None
        self._blind_since_ns: int | None = None

    def decide(
        self,
        *,
        now_ns: int,
        odometry_ns: int | None,
        reference_ns: int | None,
        solver_fault: str | None,
    ) -> Decision:
        """Return who commands now, from when odometry and reference last arrived.

        ``solver_fault`` is None when a new plan is at hand, otherwise why there is none.
        """
        fault = self._input_fault(now_ns, odometry_ns, reference_ns)
        if fault is None and solver_fault is None:
            self._planned_ns, self._blind_since_ns = now_ns, None
            return Decision(source=Source.MPC)
        reason = fault or solver_fault or ""
        if self._planned_ns is None:
            return Decision(source=Source.WAITING, reason=reason)
        sighted = odometry_ns is not None and now_ns - odometry_ns <= self._odom_timeout
        if sighted:
            self._blind_since_ns = None
        if now_ns - self._planned_ns <= self._plan_hold_time:
            return Decision(source=Source.PLAN, reason=reason)
        if sighted:
            return Decision(source=Source.HOVER, reason=reason)
        return self._blind(now_ns, reason)

    def _input_fault(
        self, now_ns: int, odometry_ns: int | None, reference_ns: int | None
    ) -> str | None:
        if odometry_ns is None:
            return "no odometry yet"
        if now_ns - odometry_ns > self._odom_timeout:
            return f"odometry is {_seconds(now_ns - odometry_ns)} old"
        if reference_ns is None:
            return "no reference yet"
        if now_ns - reference_ns > self._reference_timeout:
            return f"reference is {_seconds(now_ns - reference_ns)} old"
        return None

    def _blind(self, now_ns: int, reason: str) -> Decision:
        if self._blind_since_ns is None:
            self._blind_since_ns = now_ns
        if now_ns - self._blind_since_ns <= self._blind_time:
            return Decision(source=Source.BLIND, reason=reason)
        return Decision(source=Source.SILENT, reason=reason)


def _seconds(duration_ns: int) -> str:
    return f"{duration_ns / _SECOND:.2f} s"
