"""Counts and warnings of all stages."""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.control.stage import Failure


class Counts(NamedTuple):
    """Counts of a flight, explained in ``TickStats``."""

    commands: int = 0
    fallbacks: int = 0
    solver_failures: int = 0
    deadline_misses: int = 0
    rejected_inputs: int = 0
    stage_errors: int = 0


class StageLog:
    """Counts of a flight, and warnings for the log."""

    def __init__(self) -> None:
        self.counts = Counts()
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
        commands, fallbacks, *others = self.counts
        self.counts = Counts(commands + 1, fallbacks + by_fallback, *others)

    def reject(self, reason: str) -> None:
        """Count an unusable input, and warn."""
        self._count("rejected_inputs")
        self.warn(reason)

    def stage_error(self, stage: str, error: Exception) -> Failure:
        """Count an exception in a stage other than the MPC, and warn."""
        failure = Failure(stage, f"error in the {stage}: {error!r}")
        self._count("stage_errors")
        self.warn(failure.reason)
        return failure

    def solver_failure(self, reason: str) -> Failure:
        """Count a solve without plan."""
        self._count("solver_failures")
        return Failure("plan", reason)

    def deadline_miss(self, reason: str) -> Failure:
        """Count a plan that was too late."""
        self._count("deadline_misses")
        return Failure("plan", reason)

    def _count(self, name: str) -> None:
        self.counts = self.counts._replace(**{name: getattr(self.counts, name) + 1})
