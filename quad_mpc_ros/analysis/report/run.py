# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A run of the report: its flight and its metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from quad_mpc_ros.recordings.evaluation.metrics import Summary, summarise
from quad_mpc_ros.recordings.evaluation.verdict import Verdict, verdict_on
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportedRun:
    """One run; ``name`` is unique in the report."""

    name: str
    bag: Path
    flight: Flight

    @cached_property
    def summary(self) -> Summary:
        """Metrics, as in ``summary.json``."""
        return summarise(self.flight, wall_seconds=None)

    @cached_property
    def verdict(self) -> Verdict:
        """The summary in words."""
        return verdict_on(self.summary)


def read_runs(bags: Mapping[str, Path]) -> list[ReportedRun]:
    """Read bags, keyed by the name of their run. Raises the errors of :meth:`Recording.flight`."""
    return [
        ReportedRun(name=name, bag=bag, flight=Recording(bag).flight())
        for name, bag in bags.items()
    ]
