"""A run as the report shows it: its flight, its plans, its figures of merit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from quad_mpc_ros.evaluation.flight import Flight, read_flight
from quad_mpc_ros.evaluation.metrics import Summary, summarise
from quad_mpc_ros.lie import Array
from quad_mpc_ros.recordings.recorded_plans import RecordedPlan, read_plans


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportedRun:
    """One run; ``name`` tells it from the others of the report."""

    name: str
    bag: Path
    flight: Flight
    plans: Sequence[RecordedPlan]

    @cached_property
    def summary(self) -> Summary:
        """Figures of merit, as in ``summary.json``."""
        return summarise(self.flight, wall_seconds=None)

    @cached_property
    def tick_time(self) -> Array:
        """Time of each tick of the controller from the first odometry (k,) [s]."""
        return self.flight.time_of(np.asarray(self.flight.stats["stamp_ns"], dtype=np.int64))


def read_runs(bags: Mapping[str, Path]) -> list[ReportedRun]:
    """Read bags by the name of their run. Raises what :func:`read_flight` raises."""
    return [_read(name, bag) for name, bag in bags.items()]


def _read(name: str, bag: Path) -> ReportedRun:
    flight = read_flight(bag)
    plans = read_plans(bag, end_ns=int(flight.stamp_ns[-1]))
    return ReportedRun(name=name, bag=bag, flight=flight, plans=plans)
