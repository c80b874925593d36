# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Stages of the control step, their events, counts and warnings.

The control step is validate, estimate, guide, plan, decide, limit, record: one stage each. Stages
own the flight state, partly in attributes that are stages themselves.
"""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample


class Due(NamedTuple):
    """A control step that is due.

    Attributes:
        odometry: The odometry, twist in the body frame; None in a step without odometry.
        stamp_ns: Stamp of the command.
        sent_ns: Sending time of the command, by the clock of the odometry's stamps.
        now_ns: Sending time of the command, by the clock of the arrivals.
        duration: Expected duration of the command [s].
        started: Start of the control step [s], by :func:`time.perf_counter`.
    """

    odometry: OdometrySample | None
    stamp_ns: int
    sent_ns: int
    now_ns: int
    duration: float
    started: float


class Failure(NamedTuple):
    """The stage that returned no result, and the reason."""

    stage: str
    reason: str


class Stage:
    """An owner of flight state.

    A stage overrides the events that concern its state. Stages do not forward events: the
    controller calls every stage in :attr:`stages`.
    """

    @property
    def stages(self) -> tuple[Stage, ...]:
        """This stage and the stages among its attributes, each once."""
        owned = [each for each in vars(self).values() if isinstance(each, Stage)]
        return tuple(dict.fromkeys((self, *(stage for each in owned for stage in each.stages))))

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed live parameters; the flight state is kept."""

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the flight state by an announced odometry jump."""

    def engage(self, engaged: bool) -> None:
        """Set whether the vehicle executes commands."""


_COUNTS = (
    "commands",
    "fallbacks",
    "solver_failures",
    "deadline_misses",
    "rejected_inputs",
    "stage_errors",
)


class StageLog:
    """Counts of a flight, and warnings for the log."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(_COUNTS, 0)
        """Counts of a flight, explained in ``TickStats``."""
        self._warnings: list[str] = []

    def warn(self, *warnings: str) -> None:
        """Add warnings."""
        self._warnings.extend(warnings)

    def take_warnings(self) -> list[str]:
        """Return the warnings since the last call."""
        warnings, self._warnings = self._warnings, []
        return warnings

    def command(self, *, by_fallback: bool) -> None:
        """Count a command."""
        self.counts["commands"] += 1
        self.counts["fallbacks"] += by_fallback

    def reject(self, reason: str) -> None:
        """Count an unusable input, and warn."""
        self.counts["rejected_inputs"] += 1
        self.warn(reason)

    def stage_error(self, stage: str, error: Exception) -> Failure:
        """Count an exception in a stage other than the MPC, and warn."""
        failure = Failure(stage, f"error in the {stage}: {error!r}")
        self.counts["stage_errors"] += 1
        self.warn(failure.reason)
        return failure

    def no_plan(self, reason: str, *, counted: str = "solver_failures") -> Failure:
        """Count a solve without plan, or a late plan as ``deadline_misses``."""
        self.counts[counted] += 1
        return Failure("plan", reason)
