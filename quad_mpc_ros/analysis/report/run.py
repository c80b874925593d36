"""A run as the report shows it: its flight, its figures of merit, who commanded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from quad_mpc_ros.recordings.evaluation.commanding import WITHOUT_MPC
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
    warning: str = ""
    """What is wrong with the bag and how to repair it; empty of a sound one."""

    @cached_property
    def summary(self) -> Summary:
        """Figures of merit, as in ``summary.json``."""
        return summarise(self.flight, wall_seconds=None)

    @cached_property
    def verdict(self) -> Verdict:
        """The same in words."""
        return verdict_on(self.summary)


def read_runs(bags: Mapping[str, Path]) -> list[ReportedRun]:
    """Read bags by the name of their run. Raises what :meth:`Recording.flight` raises."""
    runs = []
    for name, bag in bags.items():
        recording = Recording(bag)
        flight, warning = recording.flight(), recording.warning
        runs.append(ReportedRun(name=name, bag=bag, flight=flight, warning=warning))
    return runs


@dataclass(frozen=True, kw_only=True)
class Span:
    """A time, from ``start`` to ``end`` [s], in which ``source`` commanded, and why at first."""

    start: float
    end: float
    source: str
    reason: str


def fallback_spans(flight: Flight) -> list[Span]:
    """Return the spans without the MPC, in order: each until the first tick of another source."""
    sources, time = flight.stats["source"], flight.tick_time
    if len(sources) == 0:
        return []
    begins = np.flatnonzero(np.append(True, sources[1:] != sources[:-1]))
    ends = np.append(time[begins[1:]], flight.time[-1])
    return [
        Span(
            start=float(time[begin]),
            end=float(end),
            source=str(sources[begin]),
            reason=str(flight.stats["reason"][begin]),
        )
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
        if sources[begin] in WITHOUT_MPC
    ]
